// Writes CasADi's C code of Pinocchio's forward dynamics and of its Jacobian.
// robots_casadi MODEL DIRECTORY: MODEL is what Model.saveToText wrote; prints the operations of both.
#include <casadi/casadi.hpp>

#include "pinocchio/autodiff/casadi.hpp"
#include "pinocchio/multibody.hpp"
#include "pinocchio/algorithm/aba.hpp"

#include <cstdio>
#include <string>

void load_model(pinocchio::Model & model, const char * file);  // robots_model.cpp

int main(int argc, char ** argv)
{
  if (argc != 3) return 2;
  typedef ::casadi::SX Scalar;
  typedef Eigen::Matrix<Scalar, Eigen::Dynamic, 1> Vector;
  pinocchio::Model plain;
  load_model(plain, argv[1]);
  const pinocchio::ModelTpl<Scalar> model = plain.cast<Scalar>();
  pinocchio::DataTpl<Scalar> data(model);
  const Scalar q = Scalar::sym("q", model.nq), v = Scalar::sym("v", model.nv);
  const Scalar tau = Scalar::sym("tau", model.nv);
  Vector own_q(model.nq), own_v(model.nv), own_tau(model.nv);
  pinocchio::casadi::copy(q, own_q);
  pinocchio::casadi::copy(v, own_v);
  pinocchio::casadi::copy(tau, own_tau);
  pinocchio::aba(model, data, own_q, own_v, own_tau);
  Scalar a(model.nv, 1);
  pinocchio::casadi::copy(data.ddq, a);
  a = cse(a);
  const ::casadi::Function forward("forward", {q, v, tau}, {a});
  const Scalar slopes = cse(Scalar::jacobian(a, Scalar::vertcat({q, v})));
  const ::casadi::Function jacobian("jacobian", {q, v, tau}, {slopes});
  const std::string folder = std::string(argv[2]) + "/";
  ::casadi::Dict options;
  forward.generate("forward.c", options);
  jacobian.generate("jacobian.c", options);
  std::rename("forward.c", (folder + "forward.c").c_str());
  std::rename("jacobian.c", (folder + "jacobian.c").c_str());
  std::printf("%d %d\n", static_cast<int>(forward.n_instructions()), static_cast<int>(jacobian.n_instructions()));
  return 0;
}
