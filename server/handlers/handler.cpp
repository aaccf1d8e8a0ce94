#include "server/handlers/handler.h"

#include <algorithm>
#include <array>

namespace raynest::server {
namespace {

template <class Table>
using Typed = Reply<Answer> (*)(const Services&, const Caller&, const protocol::Opened<Table>&);

template <class Table, Typed<Table> handle>
Reply<Answer> verified(const Services& services, const Caller& caller,
                       const protocol::Frame& frame) {
    const auto message = protocol::open<Table>(frame, services.limits);
    if (!message) return tl::unexpected(message.error());
    return handle(services, caller, *message);
}

template <class Table, Typed<Table> handle>
constexpr Handler line{protocol::message_of<Table>, verified<Table, handle>};

/// THE LIST of requests.
constexpr std::array table = {
    line<wire::Load, load>,         line<wire::Scenes, scenes>,   line<wire::Info, info>,
    line<wire::Parts, parts>,       line<wire::Path, path>,       line<wire::Unload, unload>,
    line<wire::Variants, variants>, line<wire::Stats, stats>,     line<wire::Query, query>,
    line<wire::Render, render>,     line<wire::Heatmap, heatmap>, line<wire::Jobs, jobs>,
    line<wire::Wait, wait>,         line<wire::Fetch, fetch>,     line<wire::CancelJob, cancel_job>,
};

}  // namespace

const Handler* find_handler(std::uint16_t type) {
    const auto found = std::find_if(table.begin(), table.end(), [&](const Handler& handler) {
        return static_cast<std::uint16_t>(handler.type) == type;
    });
    return found == table.end() ? nullptr : &*found;
}

}  // namespace raynest::server
