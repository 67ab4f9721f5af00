// An engine in C++: the classical Runge-Kutta method for one body on a hinge.
//
// c++ -O2 -std=c++17 -o hinge my_engine.cpp
// crosscheck verify --engine "order=4 ./hinge {scene} {step} {out}" --scene hinge_pendulum
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>
using Vector = std::vector<double>;

// The first `count` numbers after a key; a real engine takes a JSON library.
Vector read(const std::string& json, const std::string& key, size_t count) {
  Vector found;
  const char* at = json.c_str() + json.find('"' + key + "\":") + key.size() + 3;
  for (char* end; found.size() < count; at = end) {
    while (*at == '[' || *at == ',' || *at == ']' || *at == ' ') ++at;
    found.push_back(std::strtod(at, &end));
  }
  return found;
}
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vector turned(const Vector& u, double w, const Vector& a) {  // a vector by the quaternion (w, u)
  const Vector b = cross(u, a), c = cross(u, b);
  return {a[0] + 2 * (w * b[0] + c[0]), a[1] + 2 * (w * b[1] + c[1]), a[2] + 2 * (w * b[2] + c[2])};
}

int main(int, char** word) {
  std::ifstream file(word[1]);
  const std::string json{std::istreambuf_iterator<char>(file), {}};
  auto once = [&](const std::string& text) { return json.find(text) != json.npos && json.find(text) == json.rfind(text); };
  if (!once("\"mass\"") || !once("\"child_anchor\"") || !once("\"revolute\"") || !once("\"forces\": []"))
    return std::fprintf(stderr, "it knows one body on a hinge with the ground, under gravity\n"), 3;
  const double mass = read(json, "mass", 1)[0], duration = read(json, "duration", 1)[0];
  const Vector J = read(json, "inertia", 9), g = read(json, "gravity", 3), q = read(json, "attitude", 4);
  const Vector pivot = read(json, "parent_anchor", 3), to = read(json, "child_anchor", 3), c{-to[0], -to[1], -to[2]};
  const Vector axis = read(json, "parent_axis", 3), own = read(json, "child_axis", 3), lever = cross(own, c);
  const Vector start{q[1], q[2], q[3]}, row{dot(own, {J[0], J[1], J[2]}), dot(own, {J[3], J[4], J[5]}), dot(own, {J[6], J[7], J[8]})};
  const double inertia = dot(own, row) + mass * dot(lever, lever);
  auto arm = [&](double a) {  // from the pivot to the centre of mass, world
    return turned({axis[0] * std::sin(a / 2), axis[1] * std::sin(a / 2), axis[2] * std::sin(a / 2)}, std::cos(a / 2), turned(start, q[0], c));
  };
  auto speedup = [&](double a) { return mass * dot(axis, cross(arm(a), g)) / inertia; };
  double a = 0, rate = dot(own, read(json, "angular_velocity", 3));
  const int outputs = int(read(json, "samples", 1)[0]) - 1;
  const int steps = int(std::ceil(duration / outputs / std::atof(word[2]) - 1e-9));
  const double h = duration / outputs / steps;
  std::FILE* out = std::fopen(word[3], "w");
  const size_t begin = json.find("\"name\": \"", json.find("\"bodies\"")) + 9;
  const std::string name = json.substr(begin, json.find('"', begin) - begin);
  std::fprintf(out, "t");
  for (const char* title : {"x_x", "x_y", "x_z", "v_x", "v_y", "v_z", "q_w", "q_x", "q_y", "q_z", "w_x", "w_y", "w_z"})
    std::fprintf(out, ",%s %s", name.c_str(), title);
  for (int k = 0; k <= outputs; ++k) {
    const double s = std::sin(a / 2), t = std::cos(a / 2);
    const Vector x = arm(a), v = cross(axis, x), u{s * axis[0], s * axis[1], s * axis[2]}, n = cross(u, start);
    std::fprintf(out, "\n%.17g", duration * k / outputs);
    for (int i = 0; i < 3; ++i) std::fprintf(out, ",%.17g", pivot[i] + x[i]);
    for (int i = 0; i < 3; ++i) std::fprintf(out, ",%.17g", rate * v[i]);
    std::fprintf(out, ",%.17g", t * q[0] - dot(u, start));
    for (int i = 0; i < 3; ++i) std::fprintf(out, ",%.17g", t * start[i] + q[0] * u[i] + n[i]);
    for (int i = 0; i < 3; ++i) std::fprintf(out, ",%.17g", rate * own[i]);
    for (int i = 0; i < steps && k < outputs; ++i) {
      const double k1 = speedup(a), r2 = rate + h / 2 * k1, k2 = speedup(a + h / 2 * rate);
      const double r3 = rate + h / 2 * k2, k3 = speedup(a + h / 2 * r2), r4 = rate + h * k3, k4 = speedup(a + h * r3);
      a += h / 6 * (rate + 2 * r2 + 2 * r3 + r4), rate += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    }
  }
  std::fclose(out);
}
