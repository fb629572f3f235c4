// Times Pinocchio's forward dynamics and its derivatives in a loop over random states.
// robots_pinocchio MODEL SECONDS: MODEL is what Model.saveToText wrote; prints two times in ns.
#include "pinocchio/multibody.hpp"
#include "pinocchio/algorithm/aba-derivatives.hpp"
#include "pinocchio/algorithm/aba.hpp"
#include "pinocchio/algorithm/joint-configuration.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

void load_model(pinocchio::Model & model, const char * file);  // robots_model.cpp

namespace {
const int kStates = 64;
double sink = 0.0;

// The least mean time of a call, of rounds over all states.
template<typename Call>
double least(double seconds, Call call)
{
  using clock = std::chrono::steady_clock;
  double best = 1e30, spent = 0.0;
  while (spent < seconds) {
    const auto began = clock::now();
    for (int round = 0; round < 8; ++round)
      for (int i = 0; i < kStates; ++i) call(i);
    const double took = std::chrono::duration<double>(clock::now() - began).count();
    best = std::min(best, took / (8 * kStates));
    spent += took;
  }
  return 1e9 * best;
}
}  // namespace

int main(int argc, char ** argv)
{
  if (argc != 3) return 2;
  pinocchio::Model model;
  load_model(model, argv[1]);
  pinocchio::Data data(model);
  model.lowerPositionLimit.setConstant(-1.0);
  model.upperPositionLimit.setConstant(1.0);
  std::vector<Eigen::VectorXd> q, v, tau;
  for (int i = 0; i < kStates; ++i) {
    q.push_back(pinocchio::randomConfiguration(model));
    v.push_back(Eigen::VectorXd::Random(model.nv));
    tau.push_back(Eigen::VectorXd::Random(model.nv));
  }
  const double seconds = std::atof(argv[2]);
  const double forward = least(seconds, [&](int i) {
    sink += pinocchio::aba(model, data, q[i], v[i], tau[i])[0];
  });
  const double derivatives = least(seconds, [&](int i) {
    pinocchio::computeABADerivatives(model, data, q[i], v[i], tau[i]);
    sink += data.ddq_dq(0, 0);
  });
  std::printf("%.1f %.1f\n", forward, derivatives);
  return sink == 1.0;
}
