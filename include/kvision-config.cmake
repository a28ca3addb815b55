# find_package(kvision): the target kvision::kvision is the C++ API of include/kvision, the operators' libraries and Torch.
#
#   cmake -DCMAKE_PREFIX_PATH="$(python -m kvision.info --cmake-prefix-path)" ...
#
# names the folders of kvision and of torch in Python's site-packages.
include(CMakeFindDependencyMacro)
find_dependency(Torch)

if(NOT TARGET kvision::kvision)
  get_filename_component(_kvision_lib ${CMAKE_CURRENT_LIST_DIR}/../.. ABSOLUTE)
  find_path(_kvision_include kvision/kvision.h PATHS ${_kvision_lib}/../include ${_kvision_lib}/../../include
            NO_DEFAULT_PATH NO_CACHE REQUIRED)
  add_library(kvision::kvision SHARED IMPORTED)
  set_target_properties(kvision::kvision PROPERTIES IMPORTED_LOCATION ${_kvision_lib}/libkvision.so)
  target_include_directories(kvision::kvision INTERFACE ${_kvision_include})
  target_compile_features(kvision::kvision INTERFACE cxx_std_20)
  target_link_libraries(kvision::kvision INTERFACE ${TORCH_LIBRARIES})
  # Loading the libraries registers the operators. No symbol of them is used, so the linker must be told to keep them.
  target_link_options(kvision::kvision INTERFACE LINKER:--no-as-needed)

  if(TARGET torch_cuda AND EXISTS ${_kvision_lib}/libkvision_cuda.so)
    # Torch's libraries end with --as-needed, which would leave out what follows them.
    target_link_libraries(kvision::kvision
                          INTERFACE "-Wl,--push-state,--no-as-needed,${_kvision_lib}/libkvision_cuda.so,--pop-state")
  endif()
endif()
