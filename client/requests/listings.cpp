#include "client/requests/listings.h"

#include <algorithm>

namespace raynest::client {

std::string job_kind(const wire::JobInfo& info) {
    const std::string_view detail = protocol::text(info.detail());
    return std::string(protocol::text(info.kind())) +
           (detail.empty() ? "" : " " + std::string(detail));
}

std::string job_text(const wire::JobInfo& info) {
    return "job " + std::to_string(info.job()) + " (" + job_kind(info) + ", " +
           std::string(protocol::text(info.scene())) + ")";
}

Result<void> check_listed(std::uint64_t count) {
    if (count <= listed_max) return {};
    return daemon_sent("a list of more than " + std::to_string(listed_max) + " entries");
}

Result<void> each_job(Connection& connection,
                      const std::function<void(const wire::JobInfo&)>& consume) {
    wire::JobsT request;
    std::uint64_t count = 0;
    for (bool more = true; more;) {
        const auto page = ask<wire::JobList>(connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const auto* jobs = (*page)->jobs();
        if (jobs == nullptr) break;
        more = (*page)->more() && jobs->size() != 0;
        if (auto fits = check_listed(count += jobs->size()); !fits) return fits;
        for (const wire::JobInfo* info : *jobs) {
            if (info->job() <= request.after) return daemon_sent("a job twice in a list");
            consume(*info);
            request.after = info->job();
        }
    }
    return {};
}

Result<void> check_job(const wire::JobInfo& info) {
    if (info.code() == 0) return {};
    Failure why =
        failure({static_cast<protocol::Code>(info.code()),
                 job_text(info) + " failed: " + std::string(protocol::text(info.error())), 0});
    why.lost = false;  // it is the job that ended, not the connection
    return tl::unexpected<Failure>(std::move(why));
}

Result<FoundJob> find_job(Connection& connection, std::uint64_t number) {
    wire::JobsT request;
    request.after = number == 0 ? 0 : number - 1;
    auto list = ask<wire::JobList>(connection, request);
    if (!list) return tl::unexpected<Failure>(list.error());
    const auto* jobs = (*list)->jobs();
    if (jobs == nullptr || jobs->size() == 0 || jobs->Get(0)->job() != number)
        return tl::unexpected<Failure>(failure(
            {protocol::Code::job_unknown,
             "there is no job " + std::to_string(number) + ", or its answer is gone; see `Jobs`",
             0}));
    return FoundJob{std::move(*list), jobs->Get(0)};
}

Result<std::vector<ListedScene>> list_scenes(Connection& connection) {
    std::vector<ListedScene> scenes;
    wire::ScenesT request;
    // An empty page ends a list that shrank meanwhile.
    for (bool more = true; more;) {
        const auto page = ask<wire::SceneList>(connection, request);
        if (!page) return tl::unexpected<Failure>(page.error());
        const wire::SceneList& list = *page->message.table;
        const std::vector<std::string> names = protocol::strings(list.names());
        if (auto fits = check_listed(scenes.size() + names.size()); !fits)
            return tl::unexpected<Failure>(fits.error());
        const std::vector<std::string> hashes = protocol::strings(list.hashes());
        std::vector<std::string> shares = protocol::strings(list.shares());
        shares.resize(names.size());
        std::vector<std::string> states = protocol::strings(list.states());
        states.resize(names.size(), "memory");
        for (std::size_t k = 0; k < names.size(); ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            scenes.push_back({names[k], hashes[k], list.owners()->Get(i)->str(), shares[k],
                              list.epochs()->Get(i), list.instanced_triangles()->Get(i),
                              list.bytes()->Get(i),
                              static_cast<double>(list.age_ms()->Get(i)) / 1e3,
                              static_cast<double>(list.idle_ms()->Get(i)) / 1e3,
                              list.holders()->Get(i), states[k]});
        }
        request.first += static_cast<std::uint32_t>(names.size());
        more = !names.empty() && request.first < list.total();
    }
    return scenes;
}

Result<void> each_connection(Connection& connection,
                             const std::function<void(const ListedConnection&)>& consume) {
    wire::AdminT request;
    request.act = "connections";
    std::uint64_t listed = 0;
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
        if (auto fits = check_listed(listed += count); !fits) return fits;
        for (std::size_t k = 0; k < count; ++k) {
            const auto i = static_cast<flatbuffers::uoffset_t>(k);
            if (report.connections()->Get(i) <= request.after)
                return daemon_sent("a connection twice in a list");
            consume({report.connections()->Get(i), principals[k], roles[k], transports[k], peers[k],
                     static_cast<double>(report.age_ms()->Get(i)) / 1e3, report.jobs()->Get(i)});
            request.after = report.connections()->Get(i);
        }
        if (count == 0) break;
    }
    return {};
}

}  // namespace raynest::client
