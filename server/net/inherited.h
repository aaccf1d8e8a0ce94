// Listening sockets that a service manager keeps open while the daemon restarts, so that no client
// is refused meanwhile. systemd passes them as descriptors 3, 4, ... and says so in LISTEN_FDS.
#pragma once

#include "server/ground/address.h"

#include <vector>

namespace raynest::server {

class InheritedSockets {
public:
    /// Takes the sockets that LISTEN_FDS and LISTEN_PID announce for this process.
    InheritedSockets();

    /// Sets the descriptor of an address if an inherited socket listens on it.
    void claim(Address& address);
    /// Logs the addresses of sockets that claim() did not take.
    void warn_of_unclaimed() const;

private:
    std::vector<Address> sockets_;
};

}  // namespace raynest::server
