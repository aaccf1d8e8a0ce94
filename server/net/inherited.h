// Listening sockets that a service manager keeps open while the daemon restarts, so that no client
// is refused meanwhile. systemd passes them as descriptors 3, 4, ... and says so in LISTEN_FDS.
#pragma once

#include "engine/system/child_process.h"
#include "server/ground/address.h"

#include <string>
#include <vector>

namespace raynest::server {

/// A listening socket of a daemon that gives way (daemon/takeover.h).
struct HandedSocket {
    std::string value;      ///< the value of the option that named it there
    bool has_file = false;  ///< the socket's file is to be removed at the end
    Fd descriptor;
};

class InheritedSockets {
public:
    /// Takes the sockets that LISTEN_FDS and LISTEN_PID announce for this process.
    InheritedSockets();

    /// Takes the sockets of the daemon before this one.
    void add(std::vector<HandedSocket> sockets);

    /// Sets the descriptor of an address, which an option names by `value`, if an inherited socket
    /// listens on it. A port 0 is the one that a daemon before this one has picked for it.
    void claim(Address& address, const std::string& value);
    /// Logs the addresses of sockets that claim() did not take.
    void warn_of_unclaimed() const;
    /// Closes those of a daemon before, and removes their files. Call it once that accepts no more:
    /// whoever connects there is refused then.
    void drop_unclaimed();

private:
    struct Row {
        Address address;
        std::string value;  ///< from a daemon before; empty: the service manager's
    };
    std::vector<Row> sockets_;
};

}  // namespace raynest::server
