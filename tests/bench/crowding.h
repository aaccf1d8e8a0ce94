// Is the core ours? Where two hardware threads share one, what runs on the other (a neighbour's
// machine, which no clock of ours sees) takes issue slots and caches, and costs most what uses
// most: code with many independent instructions a cycle, as batches of rays, loses a third, code
// that waits, as single rays do, little. Ratios of the two are then of the neighbour, not of the
// code.
#pragma once

namespace raynest::bench {

/// Cycles of independent instructions over those of as many that wait for each other, so that the
/// frequency drops out. Some 10 microseconds, in registers alone. Least where the core is ours, up
/// to twice that where it is shared.
double crowding();

}  // namespace raynest::bench
