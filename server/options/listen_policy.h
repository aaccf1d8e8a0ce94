// Says what is open to whom: the addresses that are listened on, the access to Unix sockets and the
// options of security, judged together. The start, a reload and --check-config ask here.
#pragma once

#include "server/options/options.h"

#include <map>
#include <optional>
#include <string>
#include <vector>

namespace raynest::server {

/// An address that is listened on, or is to be.
struct ListenAddress {
    std::string option;  ///< listen or http
    std::string value;   ///< as the option gives it
    Address address;
};

/// Peers that one address is open to.
struct Openness {
    /// Roles of peers that show neither a token nor a certificate, by the places they may come
    /// from; an empty role: such a peer is refused.
    std::map<PeerIdentity::Place, std::optional<Role>> strangers;
    bool tokens = false;        ///< a token lets in
    bool certificates = false;  ///< a certificate lets in
    std::string fault;          ///< why the address must not be open so; empty: it may
};

/// Returns the addresses that the options ask for. Fails with the first that is invalid or given
/// twice.
[[nodiscard]] tl::expected<std::vector<ListenAddress>, OptionFault> listen_addresses(
    const Options& options);

[[nodiscard]] Openness openness(const ListenAddress& at, const SecurityOptions& security,
                                const SocketAccess& socket);
/// Describes it in words: "tokens; this machine as user".
[[nodiscard]] std::string to_text(const Openness& open);

/// Returns which open address lets more peers in with the options `then` than with `now`, and why;
/// empty if none does.
[[nodiscard]] std::string weakened(const std::vector<ListenAddress>& open,
                                   const SecurityOptions& now, const SecurityOptions& then,
                                   const SocketAccess& socket);

}  // namespace raynest::server
