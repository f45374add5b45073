// Proves by CAPD that the orbit of the chain of 24 sites exists near a computed one, and encloses its frequency.
//
//     y_n'' = 1.25 y_{n-1} - 3 y_n + 0.75 y_{n+1} + y_n^3,   velocities 0 at t = 0,   all y_n = 0 at a quarter of the period
//
// Unknowns: the y_n(0), read from standard input. With P the map to the section y_24 = 0, the equations are
// P_n(y) = 0 for the other sites and sum y_n^2 = S. The interval Newton operator maps the box into itself.

#include <iostream>
#include <string>
#include "capd/capdlib.h"

using namespace capd;
using capd::autodiff::Node;

const int SITES = 24, LAST = SITES - 1;

void chain(Node, Node in[], int, Node out[], int, Node[], int) {
  for (int n = 0; n < SITES; ++n) {
    out[n] = in[SITES + n];
    Node force = Node(-3.) * in[n] + sqr(in[n]) * in[n];
    if (n > 0) force = force + Node(1.25) * in[n - 1];
    if (n < LAST) force = force + Node(0.75) * in[n + 1];
    out[SITES + n] = force;
  }
}

IVector at_rest(const IVector& y) {
  IVector state(2 * SITES);
  for (int n = 0; n < SITES; ++n) state[n] = y[n];
  return state;
}

interval excess(const IVector& y, double S) {
  interval sum(-S);
  for (int n = 0; n < SITES; ++n) sum += sqr(y[n]);
  return sum;
}

int main(int, char** arguments) {
  const double S = std::stod(arguments[1]), radius = std::stod(arguments[2]);
  IMap field(chain, 2 * SITES, 2 * SITES, 0);
  IOdeSolver solver(field, std::stoi(arguments[3]));
  ICoordinateSection section(2 * SITES, LAST);
  IPoincareMap map(solver, section);

  IVector center(SITES), box(SITES);
  for (int n = 0; n < SITES; ++n) {
    double value;
    std::cin >> value;
    center[n] = interval(value);
    box[n] = center[n] + radius * interval(-1., 1.);
  }

  C0HORect2Set point(at_rest(center));
  IVector end = map(point), residual(SITES);
  for (int n = 0; n < LAST; ++n) residual[n] = end[n];
  residual[LAST] = excess(center, S);

  C1HORect2Set set(at_rest(box));
  IMatrix flow(2 * SITES, 2 * SITES), slopes(SITES, SITES);
  interval quarter;
  end = map(set, flow, quarter);
  IMatrix derivative = map.computeDP(end, flow, quarter);
  for (int n = 0; n < LAST; ++n)
    for (int k = 0; k < SITES; ++k) slopes[n][k] = derivative[n][k];
  for (int k = 0; k < SITES; ++k) slopes[LAST][k] = 2. * box[k];

  IVector image = center - matrixAlgorithms::gauss(slopes, residual);
  interval widest(0.), Omega = interval::pi() / (2. * quarter);
  for (int n = 0; n < SITES; ++n) widest = max(widest, interval(diam(image[n]).rightBound()));
  std::cout.precision(17);
  std::cout << subsetInterior(image, box) << " " << Omega.leftBound() << " " << Omega.rightBound() << " "
            << widest.rightBound() << std::endl;
}
