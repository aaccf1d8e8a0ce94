// The CPUs that this process may use, counted from 0.
#pragma once

namespace raynest::bench {

unsigned cpu_count();

/// The calling thread stays on the n-th, counted round.
void pin(unsigned n);

}  // namespace raynest::bench
