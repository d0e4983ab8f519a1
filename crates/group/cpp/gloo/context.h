// The names of gloo that c10d's ProcessGroupGloo.hpp uses. libtorch contains gloo but does not ship its headers; these
// declarations are enough, because no object of these types is created here.
#pragma once
#include <chrono>

namespace gloo {
class Context {
 public:
  void setTimeout(std::chrono::milliseconds timeout);
};
}  // namespace gloo
