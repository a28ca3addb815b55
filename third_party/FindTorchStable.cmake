# Torch's stable ABI: its headers and the libraries that resolve its symbols at run time.
#
# torch is asked where it is through Python (Python_EXECUTABLE, or the python on the PATH); TORCH_ROOT overrides, for a
# LibTorch without Python. Defines TorchStable::headers, TorchStable::cpu and TorchStable::cuda.
#
# Licence of torch: BSD-3-Clause. Nothing of it is copied here.

set(TORCH_STABLE_TARGET 0x020b000000000000)  # 2.11, the oldest torch the libraries run on

if(NOT TORCH_ROOT)
  find_package(Python COMPONENTS Interpreter REQUIRED)
  execute_process(
    COMMAND ${Python_EXECUTABLE} -c
            "import importlib.util as u; print(u.find_spec('torch').submodule_search_locations[0])"
    OUTPUT_VARIABLE TORCH_ROOT OUTPUT_STRIP_TRAILING_WHITESPACE RESULT_VARIABLE _status ERROR_QUIET)
  if(_status)
    set(TORCH_ROOT "")
  endif()
endif()

include(FindPackageHandleStandardArgs)
find_path(TorchStable_INCLUDE_DIR torch/csrc/stable/library.h PATHS ${TORCH_ROOT}/include NO_DEFAULT_PATH)
find_library(TorchStable_CPU_LIBRARY torch_cpu PATHS ${TORCH_ROOT}/lib NO_DEFAULT_PATH)
find_library(TorchStable_CUDA_LIBRARY torch_cuda PATHS ${TORCH_ROOT}/lib NO_DEFAULT_PATH)
find_package_handle_standard_args(
  TorchStable REQUIRED_VARS TorchStable_INCLUDE_DIR TorchStable_CPU_LIBRARY
  REASON_FAILURE_MESSAGE "torch >= 2.11 was not found: pip install torch, or set TORCH_ROOT to a LibTorch folder")

if(TorchStable_FOUND AND NOT TARGET TorchStable::headers)
  add_library(TorchStable::headers INTERFACE IMPORTED)
  target_include_directories(TorchStable::headers SYSTEM INTERFACE ${TorchStable_INCLUDE_DIR})
  target_compile_definitions(TorchStable::headers INTERFACE TORCH_TARGET_VERSION=${TORCH_STABLE_TARGET})

  add_library(TorchStable::cpu SHARED IMPORTED)
  set_target_properties(TorchStable::cpu PROPERTIES IMPORTED_LOCATION ${TorchStable_CPU_LIBRARY})

  # A CPU build of torch has no libtorch_cuda.so. The CUDA library only has to name it as needed, so an empty library of
  # that name stands in at link time; a torch with CUDA brings the real one.
  if(NOT TorchStable_CUDA_LIBRARY AND CMAKE_SYSTEM_NAME STREQUAL "Linux")
    set(TorchStable_CUDA_LIBRARY ${CMAKE_CURRENT_BINARY_DIR}/stand_in/libtorch_cuda.so)
    file(MAKE_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/stand_in)
    file(WRITE ${CMAKE_CURRENT_BINARY_DIR}/stand_in/empty.cpp "void* aoti_torch_get_current_cuda_stream_stand_in;\n")
    execute_process(
      COMMAND ${CMAKE_CXX_COMPILER} -shared -fPIC -Wl,-soname,libtorch_cuda.so -o ${TorchStable_CUDA_LIBRARY}
              ${CMAKE_CURRENT_BINARY_DIR}/stand_in/empty.cpp COMMAND_ERROR_IS_FATAL ANY)
  endif()
  add_library(TorchStable::cuda SHARED IMPORTED)
  set_target_properties(TorchStable::cuda PROPERTIES IMPORTED_LOCATION ${TorchStable_CUDA_LIBRARY})
endif()
