// Reads a model that Model.saveToText wrote. Apart from the rest: optimising this takes gigabytes.
#include "pinocchio/multibody.hpp"
#include "pinocchio/serialization.hpp"

void load_model(pinocchio::Model & model, const char * file) { model.loadFromText(file); }
