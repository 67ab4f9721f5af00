#include "run/implicit.hpp"

namespace lieeuler {

template RunMethod run_method<ExpMap>;

}  // namespace lieeuler
