#include "server/requests/request.h"

#include "server/scheduling/admission.h"
#include "server/scheduling/detached.h"
#include "server/security/access.h"

#include <array>
#include <cstddef>

namespace raynest::server {
namespace {

template <class Table>
using Typed = Reply<Answer> (*)(const Services&, const Caller&, const protocol::Opened<Table>&);

/// Answers for another principal's job as for one that does not exist: nobody learns of it.
Reply<void> check_own_job(const Services& services, const Caller& caller, std::uint64_t number) {
    const JobRecord* job = services.admission.find(number);
    const auto kept = services.detached.all().find(number);
    if (job == nullptr && kept != services.detached.all().end()) job = &kept->second->record();
    if (job != nullptr && access::may_use_job(job->principal, caller)) return {};
    return tl::unexpected(services.detached.unknown(number));
}

template <class Table, Typed<Table> handle, Needs needs>
Reply<Answer> verified(const Services& services, const Caller& caller,
                       const protocol::Frame& frame) {
    const auto message = protocol::open<Table>(frame, services.limits);
    if (!message) return tl::unexpected(message.error());
    if constexpr (needs == Needs::own_job)
        if (const auto own = check_own_job(services, caller, (*message)->job()); !own)
            return tl::unexpected(own.error());
    return handle(services, caller, *message);
}

template <class Table>
std::uint32_t deadline_ms(const protocol::Frame& frame, const protocol::Limits& limits) {
    const auto message = protocol::open<Table>(frame, limits);
    if (!message) return 0;
    const Table& table = *message->table;
    if constexpr (requires { table.job()->deadline_ms(); })
        return table.job() == nullptr ? 0 : table.job()->deadline_ms();
    else if constexpr (requires { table.deadline_ms(); })
        return table.deadline_ms();
    else
        return 0;
}

// A request has no default role: a row without one does not compile.
template <class Table, Typed<Table> handle, Needs needs, Role role>
constexpr Request request{protocol::message_of<Table>, role, verified<Table, handle, needs>,
                          deadline_ms<Table>};

/// The table of requests.
constexpr std::array rows = {
#define RAYNEST_REQUEST(number, Name, handler, needs, role, ...) \
    request<wire::Name, handler, Needs::needs, Role::role>,
#include "protocol/lists/requests.def"
};

/// Message types below this value are sent by clients.
constexpr std::size_t client_types = 128;

constexpr std::size_t none = rows.size();

/// Numbers of rows by message type; `none` for types without a row. They are no pointers: with
/// sanitizers g++ compares these at run time alone.
constexpr auto by_type = [] {
    std::array<std::size_t, client_types> found{};
    found.fill(none);
    for (std::size_t i = 0; i < none; ++i) found[static_cast<std::size_t>(rows[i].type)] = i;
    return found;
}();

}  // namespace

const Request* find_request(std::uint16_t type) {
    const std::size_t row = type < client_types ? by_type[type] : none;
    return row < none ? &rows[row] : nullptr;
}

}  // namespace raynest::server
