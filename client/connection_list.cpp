#include "client/connection_list.h"

#include <algorithm>

namespace raynest::client {

Result<void> each_connection(Connection& connection,
                             const std::function<void(const ListedConnection&)>& consume) {
    wire::AdminT request;
    request.act = "connections";
    for (bool more = true; more;) {
        const auto page = ask<wire::AdminReport>(connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const wire::AdminReport& report = *page->message.table;
        more = report.more();
        const auto principals = protocol::strings(report.principals());
        const auto roles = protocol::strings(report.roles());
        const auto transports = protocol::strings(report.transports());
        const auto peers = protocol::strings(report.peers());
        const std::size_t count =
            std::min({principals.size(), roles.size(), transports.size(), peers.size()});
        for (std::size_t k = 0; k < count; ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            consume({report.connections()->Get(i), principals[k], roles[k], transports[k], peers[k],
                     static_cast<double>(report.age_ms()->Get(i)) / 1e3, report.jobs()->Get(i)});
            request.after = report.connections()->Get(i);
        }
        if (count == 0) break;
    }
    return {};
}

}  // namespace raynest::client
