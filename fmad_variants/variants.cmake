# Build variants of the references: known-correct builds that round differently. No source copies; a variant is the
# reference compiled with other flags.
#
# gpuphys_variant(NAME FLAGS...) declares one. The paper validates its tolerances with the first.

# No contraction of a*b + c into one rounding: changes nearly every arithmetic expression, as a correct submission may.
# Explicit fmaf() and __fmaf_rn() survive the flag, so references leave contraction to the compiler, and
# <task>.fmad_differs checks that the variant's PTX holds fewer fused operations than the reference's.
gpuphys_variant(fmad -fmad=false)

# What speed costs in error: approximate roots and divisions, subnormals flushed. Judged and reported, not required to
# pass.
gpuphys_variant(fast_math -use_fast_math)

# A second known-correct build needs no flags of its own: where a reference offers other block sizes (it mentions
# GPUPHYS_OTHER_BLOCKS), gpuphys_add_task() also builds it with that macro defined, as the module `blocks`.
