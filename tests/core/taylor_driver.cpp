// A chain of one to three pendulum bodies, or the heavy top, by Taylor series, without Python: counts heap allocations
// inside the steps, times them, and is the program that callgrind and the sanitizers look at.
//
//   taylor_driver chain1|chain2|chain3|top T RTOL REPEATS
//   prints  "allocations N  steps N  microseconds X  x X Y Z"   microseconds: the fastest repeat, without set-up
#define EIGEN_RUNTIME_NO_MALLOC
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <new>
#include <string>

static long allocations = 0;
void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

#include "linalg/denormals.hpp"
#include "methods/taylor.hpp"

using namespace lieeuler;

struct Scene {
  System system;
  State initial;
};

static Scene hung(double mass, const Mat3& J, const std::vector<Vec3>& hooks, const Vec3& anchor,
                  const std::vector<Mat3>& attitudes, const std::vector<Vec3>& rates) {
  const int n = static_cast<int>(attitudes.size());
  System system{{}, {}, {}, {0, 0, -9.81}};
  for (int b = 0; b < n; ++b) {
    system.bodies.emplace_back(mass, J);
    system.joints.push_back({b == 0 ? n : b - 1, b, hooks[b], anchor, {Part{true, {}, 3 * b}}});
  }
  State state(system);
  Vec3 hook = Vec3::Zero(), speed = Vec3::Zero();
  for (int b = 0; b < n; ++b) {
    const Mat3& R = attitudes[b];
    state.frames[b] = {hook - R * anchor, R};
    state.u[b] = {speed - R * rates[b].cross(anchor), rates[b]};
    if (b + 1 == n) break;
    hook = state.frames[b].x + R * hooks[b + 1];
    speed = state.u[b].v + R * rates[b].cross(hooks[b + 1]);
  }
  return {system, state};
}

static Scene scene(const std::string& name) {
  if (name == "top")
    return hung(15, Vec3(0.234375, 0.46875, 0.234375).asDiagonal(), {Vec3::Zero()}, {0, -1, 0}, {Mat3::Identity()},
                {{0, 150, -4.61538}});
  const int n = name.back() - '0';
  const Vec3 axes[] = {Vec3::UnitY(), Vec3::UnitX(), Vec3::UnitY()};
  const Vec3 rates[] = {{.5, .3, 1}, {-.3, .4, .2}, {.1, .2, 0}};
  const double degrees[] = {60, 40, 20};
  std::vector<Vec3> hooks, w;
  std::vector<Mat3> R;
  for (int b = 0; b < n; ++b) {
    hooks.push_back(b == 0 ? Vec3::Zero() : Vec3(0, 0, -1));
    R.push_back(Eigen::AngleAxisd(degrees[b] * std::numbers::pi / 180, axes[b]).toRotationMatrix());
    w.push_back(rates[b]);
  }
  return hung(1, Vec3(0.1, 0.2, 0.15).asDiagonal(), hooks, {0, 0, 1}, R, w);
}

int main(int argc, char** argv) {
  if (argc != 5) return 64;
  const Scene made = scene(argv[1]);
  const double T = std::atof(argv[2]), rtol = std::atof(argv[3]);
  const FlushDenormals flush;
  double fastest = 1e300;
  long inside = 0;
  Counters counters;
  TaylorStepper stepper(made.system);
  const Interrupted never = [] { return false; };
  Watch watch(never, made.system);
  for (int repeat = 0; repeat < std::atoi(argv[4]); ++repeat) {
    counters = {};
    if (stepper.start(made.initial, 0, T, rtol) != Status::success) return 2;
    const long before = allocations;
    Eigen::internal::set_is_malloc_allowed(false);
    const auto begin = std::chrono::steady_clock::now();
    while (stepper.time() < T)
      if (stepper.step(counters, watch) != Status::success) return 2;
    fastest = std::min(fastest, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    Eigen::internal::set_is_malloc_allowed(true);
    inside += allocations - before;
  }
  const Vec3& x = stepper.state().frames[made.system.n() - 1].x;
  std::printf("allocations %ld  steps %ld  microseconds %.1f  x %.17g %.17g %.17g\n", inside, counters.steps,
              1e6 * fastest, x.x(), x.y(), x.z());
  return inside == 0 ? 0 : 1;
}
