// All of it as one translation unit: the headers of Ceres and Eigen take longer to read than the
// rest takes to compile.
#include "bundle.cc"
#include "circular.cc"
#include "position.cc"
