// The one main() of the unit-test binaries; doctest's implementation takes 12 s to compile once.
#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>
