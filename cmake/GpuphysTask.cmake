# gpuphys_add_task(NAME FAMILY): everything that belongs to one task, by file name.
#
#   cases/<family>/<task>.cpp               -> gpuphys_core
#   cases/<family>/<shared>.cpp             -> gpuphys_core, once, for the sources a family's tasks share
#   references/<family>/<task>.cu           -> modules/<task>/reference.so, and one module for each build variant
#   serial_baselines/<family>/<task>.cpp    -> modules/<task>/baseline_f64.so, baseline_f32.so, baseline_f32_fma.so
#   mutants/<task>/<fault>.patch            -> modules/<task>/mutant.<fault>.so and serial_mutant.<fault>.so
#
# The target task_<task> builds all of that and what the task's tests need besides: no more than one has to wait for.
#
# Patches are applied to copies in the build tree, without fuzz; one that no longer applies breaks the build. The copies
# come first on the include path, so a patch may also touch a header: all quoted includes are relative to the root.

set(GPUPHYS_TASKS "" CACHE INTERNAL "")
set(GPUPHYS_VARIANTS "" CACHE INTERNAL "")

function(gpuphys_variant name)
  set(GPUPHYS_VARIANTS ${GPUPHYS_VARIANTS} ${name} CACHE INTERNAL "")
  set(GPUPHYS_VARIANT_FLAGS_${name} ${ARGN} CACHE INTERNAL "")
endfunction()
include(${PROJECT_SOURCE_DIR}/fmad_variants/variants.cmake)

# What decides a module's code besides its sources, as one line. What this leaves out does not make a record stale.
function(gpuphys_flags_text source flags defines result)
  get_filename_component(extension ${source} EXT)
  set(all ${flags})
  foreach(define ${defines})
    list(APPEND all -D${define})
  endforeach()
  if(extension MATCHES "\\.cu$")
    set(all ${CMAKE_CUDA_FLAGS} ${CMAKE_CUDA_FLAGS_RELEASE} -std=c++${CMAKE_CUDA_STANDARD} sm_${CMAKE_CUDA_ARCHITECTURES} $ENV{NVCC_APPEND_FLAGS} ${all})
  else()
    set(all ${CMAKE_CXX_FLAGS} ${CMAKE_CXX_FLAGS_RELEASE} -std=c++${CMAKE_CXX_STANDARD} ${all})
  endif()
  list(JOIN all " " text)
  set(${result} "${text}" PARENT_SCOPE)
endfunction()

# Notes what a module should be built from, whether or not this build makes it: `gpuphys check-records` compares.
function(gpuphys_expect_module task label source flags overlay)
  file(RELATIVE_PATH relative ${PROJECT_SOURCE_DIR} ${source})
  if(relative MATCHES "^\\.\\.|^build")  # a patched copy
    file(RELATIVE_PATH relative ${overlay} ${source})
  endif()
  set_property(GLOBAL APPEND_STRING PROPERTY GPUPHYS_EXPECTED "${task}\t${label}\t${relative}\t${overlay}\t${flags}\n")
endfunction()

# A loadable module: modules/<task>/<label>.so.
function(gpuphys_module task label source)
  cmake_parse_arguments(arg "EXPECT_ONLY" "" "INCLUDE;FLAGS;DEFINES;LIBRARIES;DEPENDS" ${ARGN})
  gpuphys_flags_text(${source} "${arg_FLAGS}" "${arg_DEFINES}" flags)
  gpuphys_expect_module(${task} ${label} ${source} "${flags}" "${arg_INCLUDE}")
  if(arg_EXPECT_ONLY)
    return()
  endif()
  set(target module_${task}_${label})
  get_filename_component(extension ${source} EXT)
  add_library(${target} MODULE ${source})
  target_include_directories(${target} PRIVATE ${arg_INCLUDE} ${PROJECT_SOURCE_DIR})
  target_compile_options(${target} PRIVATE ${arg_FLAGS})
  target_compile_definitions(${target} PRIVATE ${arg_DEFINES})
  target_link_libraries(${target} PRIVATE gpuphys_warnings ${arg_LIBRARIES})
  if(arg_DEPENDS)
    add_dependencies(${target} ${arg_DEPENDS})
  endif()
  add_dependencies(task_${task} ${target})
  if(GPUPHYS_GPU_MUTANTS OR NOT extension MATCHES "\\.cu$")  # without a GPU the references only have to compile
    add_dependencies(validation ${target})
  endif()
  set_target_properties(${target} PROPERTIES PREFIX "" OUTPUT_NAME ${label} CXX_VISIBILITY_PRESET hidden
                        LIBRARY_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/modules/${task})
  set(compiler "${CMAKE_CXX_COMPILER_ID} ${CMAKE_CXX_COMPILER_VERSION}")
  if(extension MATCHES "\\.cu$")
    set(compiler "nvcc ${CMAKE_CUDA_COMPILER_VERSION}, ${compiler}")
  endif()
  file(RELATIVE_PATH relative ${PROJECT_SOURCE_DIR} ${source})
  if(relative MATCHES "^\\.\\.|^build")
    file(RELATIVE_PATH relative ${arg_INCLUDE} ${source})
  endif()
  if(NOT GPUPHYS_SANITIZE)
    add_dependencies(${target} gpuphys-stamp)
    add_custom_command(TARGET ${target} POST_BUILD VERBATIM
      COMMAND gpuphys-stamp --root ${PROJECT_SOURCE_DIR} --overlay "${arg_INCLUDE}" --source ${relative}
              --flags "${flags}" --compiler "${compiler}" --module $<TARGET_FILE:${target}>)
  endif()
endfunction()

# Patched copies of the files that a mutant touches, in mutants/<task>/<fault>/ of the build tree.
function(gpuphys_patched_copy task fault patch result)
  set(folder ${PROJECT_BINARY_DIR}/mutants/${task}/${fault})
  file(STRINGS ${patch} touched REGEX "^\\+\\+\\+ b/")
  list(TRANSFORM touched REPLACE "^\\+\\+\\+ b/([^\t ]+).*$" "\\1")
  if(NOT touched)
    message(FATAL_ERROR "${patch}: no file is patched ('+++ b/<path>' lines are missing)")
  endif()
  set(originals ${touched})
  list(TRANSFORM originals PREPEND ${PROJECT_SOURCE_DIR}/)
  set(copies ${touched})
  list(TRANSFORM copies PREPEND ${folder}/)
  add_custom_command(
    OUTPUT ${copies}
    COMMAND ${CMAKE_COMMAND} -DPATCH=${patch} -DFOLDER=${folder} -DROOT=${PROJECT_SOURCE_DIR} "-DFILES=${touched}"
            -P ${PROJECT_SOURCE_DIR}/cmake/ApplyMutant.cmake
    DEPENDS ${patch} ${originals} ${PROJECT_SOURCE_DIR}/cmake/ApplyMutant.cmake
    COMMENT "Planting ${task}: ${fault}" VERBATIM)
  add_custom_target(patched_${task}_${fault} ALL DEPENDS ${copies})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${patch})
  set(${result} ${touched} PARENT_SCOPE)
endfunction()

function(gpuphys_serial_module task label source)
  cmake_parse_arguments(arg "" "REAL" "INCLUDE;FLAGS;DEPENDS" ${ARGN})
  gpuphys_module(${task} ${label} ${source} INCLUDE ${arg_INCLUDE} DEPENDS ${arg_DEPENDS}
    FLAGS -O2 ${arg_FLAGS} DEFINES GPUPHYS_BASELINE_REAL=${arg_REAL}
    LIBRARIES Eigen3::Eigen ${GPUPHYS_CHOLMOD})
  target_include_directories(module_${task}_${label} SYSTEM PRIVATE ${GPUPHYS_CHOLMOD_INCLUDE})
endfunction()

function(gpuphys_add_task task family)
  set(case ${PROJECT_SOURCE_DIR}/cases/${family}/${task}.cpp)
  set(reference ${PROJECT_SOURCE_DIR}/references/${family}/${task}.cu)
  set(baseline ${PROJECT_SOURCE_DIR}/serial_baselines/${family}/${task}.cpp)
  foreach(part ${case} ${reference} ${baseline})
    if(NOT EXISTS ${part})
      message(FATAL_ERROR "task ${task}: ${part} is missing")
    endif()
  endforeach()
  set(GPUPHYS_TASKS ${GPUPHYS_TASKS} ${task} CACHE INTERNAL "")
  set(GPUPHYS_FAMILY_OF_${task} ${family} CACHE INTERNAL "")
  add_custom_target(task_${task})
  if(NOT TARGET validation)
    add_custom_target(validation)
  endif()
  target_sources(gpuphys_core PRIVATE ${case})

  # gpuphys_finish() adds what the tasks of these families share.
  get_property(families GLOBAL PROPERTY GPUPHYS_FAMILIES)
  if(NOT family IN_LIST families)
    set_property(GLOBAL APPEND PROPERTY GPUPHYS_FAMILIES ${family})
  endif()

  # The FP64 truth, and FP32 builds with and without contraction: known-correct variants that need no GPU.
  gpuphys_serial_module(${task} baseline_f64 ${baseline} REAL double FLAGS -ffp-contract=off)
  if(GPUPHYS_SERIAL_VARIANTS)
    gpuphys_serial_module(${task} baseline_f32 ${baseline} REAL float FLAGS -ffp-contract=off)
    gpuphys_serial_module(${task} baseline_f32_fma ${baseline} REAL float FLAGS -ffp-contract=fast -mfma)
  endif()

  if(GPUPHYS_HAS_CUDA)
    gpuphys_module(${task} reference ${reference} LIBRARIES gpuphys_primitives)
    foreach(variant ${GPUPHYS_VARIANTS})
      gpuphys_module(${task} ${variant} ${reference} FLAGS ${GPUPHYS_VARIANT_FLAGS_${variant}}
                     LIBRARIES gpuphys_primitives)
      if(variant STREQUAL fmad)
        gpuphys_ptx_test(${task} ${variant} ${reference})
      endif()
    endforeach()
    # A reference that offers another choice of blocks is built with it as well: rounding must not depend on them by much.
    file(STRINGS ${reference} offers_other_blocks REGEX "GPUPHYS_OTHER_BLOCKS")
    if(offers_other_blocks)
      gpuphys_module(${task} blocks ${reference} DEFINES GPUPHYS_OTHER_BLOCKS=1 LIBRARIES gpuphys_primitives)
    endif()
  endif()

  file(GLOB patches CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/mutants/${task}/*.patch)
  if(GPUPHYS_SANITIZE)
    set(patches "")
  endif()
  foreach(patch ${patches})
    get_filename_component(fault ${patch} NAME_WE)
    gpuphys_patched_copy(${task} ${fault} ${patch} touched)
    set(copy ${PROJECT_BINARY_DIR}/mutants/${task}/${fault})
    # A patch may touch the source itself or only a header of it.
    set(mutated_baseline ${baseline})
    if(serial_baselines/${family}/${task}.cpp IN_LIST touched)
      set(mutated_baseline ${copy}/serial_baselines/${family}/${task}.cpp)
    endif()
    set(mutated_reference ${reference})
    if(references/${family}/${task}.cu IN_LIST touched)
      set(mutated_reference ${copy}/references/${family}/${task}.cu)
    endif()
    # A patch plants its fault where it has a hunk; that every patch has both is for the inventory test to say.
    if(touched MATCHES "serial_baselines/" AND GPUPHYS_SERIAL_VARIANTS)
      gpuphys_serial_module(${task} serial_mutant.${fault} ${mutated_baseline} REAL float FLAGS -ffp-contract=off
                            INCLUDE ${copy} DEPENDS patched_${task}_${fault})
    endif()
    if(touched MATCHES "references/" AND GPUPHYS_HAS_CUDA)
      set(only EXPECT_ONLY)
      if(GPUPHYS_GPU_MUTANTS)
        set(only "")
      endif()
      gpuphys_module(${task} mutant.${fault} ${mutated_reference} INCLUDE ${copy} DEPENDS patched_${task}_${fault}
                     LIBRARIES gpuphys_primitives ${only})
    endif()
  endforeach()
endfunction()

# <task>.<variant>_differs: the variant's PTX must hold fewer fused multiply-adds than the reference's.
function(gpuphys_ptx_test task variant source)
  set(folder ${PROJECT_BINARY_DIR}/ptx/${task})
  foreach(build reference ${variant})
    set(flags "")
    if(NOT build STREQUAL reference)
      set(flags ${GPUPHYS_VARIANT_FLAGS_${build}})
    endif()
    add_custom_command(
      OUTPUT ${folder}/${build}.ptx
      COMMAND ${CMAKE_COMMAND} -E make_directory ${folder}
      COMMAND ${CMAKE_CUDA_COMPILER} -ptx -std=c++20 -O3 -DNDEBUG -arch=sm_90 -I${PROJECT_SOURCE_DIR} ${flags} ${source}
              -o ${folder}/${build}.ptx
      DEPENDS ${source} module_${task}_${build} COMMENT "PTX of ${task} ${build}" VERBATIM)
  endforeach()
  add_custom_target(ptx_${task}_${variant} ALL DEPENDS ${folder}/reference.ptx ${folder}/${variant}.ptx)
  add_dependencies(task_${task} ptx_${task}_${variant})
  add_test(NAME ${task}.${variant}_differs
           COMMAND ${CMAKE_COMMAND} -DREFERENCE=${folder}/reference.ptx -DVARIANT=${folder}/${variant}.ptx
                   -P ${PROJECT_SOURCE_DIR}/cmake/CheckPtxDiffers.cmake)
  set_tests_properties(${task}.${variant}_differs PROPERTIES LABELS "${task};${variant};cpu" TIMEOUT 30
                       SKIP_REGULAR_EXPRESSION "nothing to contract")
endfunction()

# After the last task: shared sources of the families in use, the registry, and the tests.
function(gpuphys_finish)
  get_property(families GLOBAL PROPERTY GPUPHYS_FAMILIES)
  foreach(family ${families})
    file(GLOB shared CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/cases/${family}/*.cpp)
    foreach(source ${shared})
      get_filename_component(stem ${source} NAME_WE)
      if(NOT stem IN_LIST GPUPHYS_TASKS)
        target_sources(gpuphys_core PRIVATE ${source})
      endif()
    endforeach()
  endforeach()

  set(declarations "")
  set(calls "")
  foreach(task ${GPUPHYS_TASKS})
    string(APPEND declarations "namespace ${task} {\nTask make_task();\n}\n")
    string(APPEND calls "    add(${task}::make_task(), \"${task}\", \"${GPUPHYS_FAMILY_OF_${task}}\");\n")
  endforeach()
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/registry.cpp CONTENT
"// Written by cmake/GpuphysTask.cmake.
#include <algorithm>

#include \"core/contract/task.hpp\"

namespace gpuphys {
${declarations}
const std::vector<Task>& all_tasks() {
  static const std::vector<Task> tasks = [] {
    std::vector<Task> all;
    const auto add = [&all](Task t, const char* name, const char* family) {
      t.name = name;
      t.family = family;
      all.push_back(std::move(t));
    };
${calls}    std::sort(all.begin(), all.end(), [](const Task& a, const Task& b) { return a.paper_number < b.paper_number; });
    return all;
  }();
  return tasks;
}

}  // namespace gpuphys
")
  target_sources(gpuphys_core PRIVATE ${PROJECT_BINARY_DIR}/registry.cpp)

  get_property(expected GLOBAL PROPERTY GPUPHYS_EXPECTED)
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/modules/expected.tsv CONTENT "@expected@" @ONLY)
  if(GPUPHYS_SANITIZE)
    return()
  endif()

  # The tests of the tasks are written by the driver once it is built. Until then CTest sees one test that fails and says
  # so, rather than an empty suite that passes.
  set(test_file ${PROJECT_BINARY_DIR}/task_tests.cmake)
  set(arguments --output ${test_file} --driver $<TARGET_FILE:gpuphys>)
  if(GPUPHYS_HAS_CUDA)
    find_program(GPUPHYS_COMPUTE_SANITIZER compute-sanitizer HINTS ${CUDAToolkit_BIN_DIR})
    if(GPUPHYS_COMPUTE_SANITIZER)
      list(APPEND arguments --sanitizer ${GPUPHYS_COMPUTE_SANITIZER})
    endif()
  endif()
  file(GLOB_RECURSE patches CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/mutants/*.patch)
  add_custom_command(OUTPUT ${test_file} COMMAND gpuphys ctest-file ${arguments} DEPENDS gpuphys ${patches}
                     COMMENT "Writing the tests of the tasks" VERBATIM)
  add_custom_target(task_tests ALL DEPENDS ${test_file})
  foreach(task ${GPUPHYS_TASKS})
    add_dependencies(task_${task} task_tests)
  endforeach()
  add_dependencies(validation task_tests)
  file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/include_task_tests.cmake CONTENT
"if(EXISTS \"${test_file}\")
  include(\"${test_file}\")
else()
  add_test(task_tests_NOT_BUILT \"${CMAKE_COMMAND}\" -E false)
endif()
")
  set_property(DIRECTORY ${PROJECT_SOURCE_DIR} APPEND PROPERTY TEST_INCLUDE_FILES
               ${PROJECT_BINARY_DIR}/include_task_tests.cmake)
endfunction()
