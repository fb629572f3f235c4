// Rates of a model by the header for C++, and what it refuses.
#include "slider_pendulum.hpp"

#include <array>
#include <cstdio>

using slider_pendulum::Model;
using slider_pendulum::real;

template <class Error, class Function> static int throws(Function function)
{
    try {
        function();
    } catch (const Error &error) {
        return error.what()[0] != '\0';
    }
    return 0;
}

int main()
{
    Model model;
    std::vector<real> x(Model::n_states);
    std::array<real, Model::n_states> dx;
    model.set(SLIDER_PENDULUM_PARAMETER_L, 1.25);
    model.initial(x);
    model.rhs(0.0, x, {}, dx);
    for (std::size_t i = 0; i < dx.size(); ++i) {
        std::printf("dx%d = %.17g\n", static_cast<int>(i), dx[i]);
    }
    int refused = throws<std::invalid_argument>([&] { model.set(SLIDER_PENDULUM_PARAMETER_m1, -1); });
    refused += model.parameter(SLIDER_PENDULUM_PARAMETER_m1) == 1.0;
    std::vector<real> few(2);
    refused += throws<std::invalid_argument>([&] { model.rhs(0.0, few, {}, dx); });
    std::printf("refused = %d\n", refused);
    return 0;
}
