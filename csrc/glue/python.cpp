// kvision._C: functions that take no tensors, such as versions and the instruction set. It needs no headers of torch.
// Where this module cannot be imported, everything else still works.
#include <pybind11/pybind11.h>

extern "C" {
char const* kvision_version();
char const* kvision_compiler();
char const* kvision_active_isa();
bool kvision_isa_supported(char const* name);
bool kvision_set_isa(char const* name);
}

PYBIND11_MODULE(_C, m) {
  m.doc() = "What libkvision.so was built with, and the instruction set its CPU kernels use.";
  m.def("version", &kvision_version);
  m.def("compiler", &kvision_compiler);
  m.def("active_isa", &kvision_active_isa, "Name of the instruction set in use: baseline, avx2, avx512 or neon.");
  m.def("isa_supported", &kvision_isa_supported,
        "Whether the library was compiled for the named instruction set and this processor has it.");
  m.def("set_isa", &kvision_set_isa, "Use the named instruction set; False, and no change, where it is not supported.");
}
