# Copies FILES from ROOT to FOLDER and applies PATCH to the copies. No fuzz: a hunk whose context moved away is an error.
find_program(patch_program patch)
if(NOT patch_program)
  message(FATAL_ERROR "the program 'patch' is missing (Debian: apt-get install patch)")
endif()
# What an earlier form of the patch touched must not stay behind: the folder comes first on the include path.
file(REMOVE_RECURSE ${FOLDER})
foreach(file ${FILES})
  configure_file(${ROOT}/${file} ${FOLDER}/${file} COPYONLY)
  # configure_file leaves an unchanged copy alone; a patched one differs, so it is always fresh here.
endforeach()
execute_process(
  COMMAND ${patch_program} --strip=1 --fuzz=0 --batch --forward --no-backup-if-mismatch --reject-file=- --input=${PATCH}
  WORKING_DIRECTORY ${FOLDER} RESULT_VARIABLE failed OUTPUT_VARIABLE output ERROR_VARIABLE output)
if(failed)
  foreach(file ${FILES})
    file(REMOVE ${FOLDER}/${file})
  endforeach()
  message(FATAL_ERROR "${PATCH} no longer applies:\n${output}")
endif()
foreach(file ${FILES})
  file(TOUCH_NOCREATE ${FOLDER}/${file})
  file(READ ${ROOT}/${file} original)
  file(READ ${FOLDER}/${file} mutated)
  if(original STREQUAL mutated)
    message(FATAL_ERROR "${PATCH} changes nothing in ${file}")
  endif()
endforeach()
