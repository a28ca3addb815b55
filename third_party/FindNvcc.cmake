# nvcc, NVIDIA's CUDA compiler (part of the CUDA toolkit, NVIDIA's licence). Sets NVCC_FOUND and CMAKE_CUDA_ARCHITECTURES:
# as -DCMAKE_CUDA_ARCHITECTURES or the environment's CUDAARCHS say, else for the GPUs of this machine, else 90.
# Releases: "75-real;80-real;86-real;89-real;90-real;100-real;120".
include(CheckLanguage)
if(NOT DEFINED CMAKE_CUDA_ARCHITECTURES AND NOT DEFINED ENV{CUDAARCHS})
  execute_process(COMMAND nvidia-smi --query-gpu=compute_cap --format=csv,noheader OUTPUT_VARIABLE _gpus
                  RESULT_VARIABLE _status ERROR_QUIET)
  string(REGEX MATCHALL "[0-9]+\\.[0-9]+" _gpus "${_gpus}")
  if(_status EQUAL 0 AND _gpus)
    list(REMOVE_DUPLICATES _gpus)
    string(REPLACE "." "" CMAKE_CUDA_ARCHITECTURES "${_gpus}")
  else()
    set(CMAKE_CUDA_ARCHITECTURES 90)
  endif()
endif()
check_language(CUDA)
if(CMAKE_CUDA_COMPILER)
  set(NVCC_FOUND TRUE)
else()
  set(NVCC_FOUND FALSE)
endif()
