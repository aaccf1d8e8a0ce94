// The only main() of the unit tests; doctest's implementation takes 12 s to compile once.
#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>
