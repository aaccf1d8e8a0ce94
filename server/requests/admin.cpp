// ADMIN: lists and ends connections, tells and changes quotas, reloads and drains the daemon.
#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/ground/limited_log.h"
#include "server/jobs/disk_job.h"
#include "server/requests/administration.h"
#include "server/requests/quota_use.h"
#include "server/requests/request.h"
#include "server/scheduling/admission.h"
#include "server/security/quotas.h"
#include "server/security/tokens.h"
#include "server/store/backup.h"
#include "server/store/state_folder.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::size_t page_connections = 100;

void list_connections(const Administration& daemon, std::uint64_t after,
                      wire::AdminReportT& report) {
    for (ConnectionRow& row : daemon.connections(after)) {
        report.more = report.connections.size() == page_connections;
        if (report.more) return;
        report.connections.push_back(row.number);
        report.principals.push_back(std::move(row.principal));
        report.roles.push_back(std::move(row.role));
        report.transports.push_back(std::move(row.transport));
        report.peers.push_back(std::move(row.peer));
        report.age_ms.push_back(row.age_ms);
        report.jobs.push_back(row.jobs);
    }
}

/// Tells what a principal uses of its quotas: "bob uses 1 of 128 jobs, 2.0 GiB of 20.0 GiB
/// scene_bytes, …".
std::string quotas_text(const Services& services, const std::string& principal) {
    std::string text = principal + " uses";
    for (const QuotaUse& use : quota_uses(services, principal)) {
        const auto number = [&](std::uint64_t value) {
            return use.resource.ends_with("bytes") ? protocol::bytes_text(value)
                                                   : std::to_string(value);
        };
        text += (text.ends_with("uses") ? " " : ", ") + number(use.used) + " of " +
                number(use.quota) + ' ' + std::string(use.resource);
    }
    return text + "; it may send and receive " +
           protocol::bytes_text(services.admission.quotas().of(principal).second_bytes) +
           " a second";
}

/// Tells the quotas of a principal, or changes them if the message has some.
Reply<void> answer_quota(const Services& services, const wire::Admin& message,
                         wire::AdminReportT& report) {
    Administration& daemon = *services.administration;
    std::string text;
    for (const std::string& part : protocol::strings(message.quota()))
        text += (text.empty() ? "" : ",") + part;
    const std::string principal(protocol::text(message.principal()));
    const bool changes = !text.empty();
    const auto quota = changes ? read_quota(text) : Quota();
    if (!quota) return refuse(Code::invalid_field, quota.error().message);
    if (principal.empty()) return refuse(Code::invalid_field, "the quota needs a principal");
    if (!daemon.knows(principal))
        return refuse(Code::not_found,
                      "nobody is called '" + principal +
                          "' here: it is not connected, holds nothing and has no token");
    if (!changes) {
        report.text = quotas_text(services, principal);
        return {};
    }
    daemon.set_quota(principal, *quota);
    report.text = principal + " has " + to_text(*quota) + " until the daemon ends";
    return {};
}

/// Ends one connection, or all of a principal. Fails if there is no such one.
Reply<std::size_t> kick(Administration& daemon, std::uint64_t connection,
                        const std::string& principal) {
    const std::size_t count = daemon.kick(connection, principal);
    if (count != 0) return count;
    if (connection != 0)
        return refuse(Code::not_found, "there is no connection " + std::to_string(connection) +
                                           "; raynest admin connections lists them");
    if (daemon.knows(principal)) return count;
    return refuse(Code::not_found, "nobody is called '" + principal +
                                       "' here; raynest admin connections lists who is connected");
}

/// Removes damaged blobs and what a restore has replaced.
Reply<Answer> collect_garbage(const Services& services, const Caller& caller) {
    if (services.state == nullptr)
        return refuse(Code::unsupported,
                      "there is nothing to collect: this daemon stores no scenes; start raynestd "
                      "with --state DIR");
    JobSubmission accepted;
    accepted.kind = "gc";
    accepted.job = disk_job(services, [&services, id = caller.request_id]() -> Reply<WriteToDisk> {
        return [&services, id]() -> Reply<protocol::Frame> {
            const auto removed = remove_set_aside(services.state->path());
            if (!removed) return refuse(removed.error());
            wire::AdminReportT report;
            report.text = *removed == 0 ? "there is nothing to remove"
                                        : protocol::bytes_text(*removed) +
                                              " removed: damaged scenes, and what a restore "
                                              "has replaced";
            return protocol::answer(id, report);
        };
    });
    return Answer{std::move(accepted)};
}

/// Reads what a reload needs on a compute thread, and takes it on the io thread.
class ReloadJob final : public Job {
public:
    ReloadJob(Administration& daemon, const Caller& caller)
        : id_(caller.request_id),
          read_(daemon.reload()) {}

    std::optional<Task> next() override {
        if (std::exchange(began_, true)) return std::nullopt;
        Task task;
        task.run = [this](const Stop&) -> Reply<Frames> {
            take_ = read_();
            return Frames{};
        };
        return task;
    }
    Reply<void> ended() override {
        auto text = take_();
        if (!text) return tl::unexpected(text.error());
        wire::AdminReportT report;
        report.text = std::move(*text);
        answer_.push_back(protocol::answer(id_, report));
        return {};
    }
    [[nodiscard]] bool finished() const override { return began_; }
    Frames farewell() override { return std::move(answer_); }

private:
    const std::uint64_t id_;
    const std::function<Administration::Take()> read_;
    bool began_ = false;
    Administration::Take take_;  ///< set by the task
    Frames answer_;
};

}  // namespace

Reply<Answer> admin(const Services& services, const Caller& caller,
                    const protocol::Opened<wire::Admin>& message) {
    if (services.administration == nullptr)
        return refuse(Code::unsupported, "this daemon has no administration");
    Administration& daemon = *services.administration;
    const std::string act(protocol::text(message->act()));
    const std::string principal(protocol::text(message->principal()));
    log_limited(LogLevel::info, "admin", caller.principal,
                {{"principal", caller.principal}, {"act", act}, {"on", principal}});
    wire::AdminReportT report;
    if (act == "connections") {
        list_connections(daemon, message->after(), report);
    } else if (act == "kick") {
        if (message->connection() == 0 && principal.empty())
            return refuse(Code::invalid_field, "name a connection or a principal");
        const auto count = kick(daemon, message->connection(), principal);
        if (!count) return tl::unexpected(count.error());
        report.text =
            std::to_string(*count) + (*count == 1 ? " connection" : " connections") + " ended";
    } else if (act == "quota") {
        if (const auto answered = answer_quota(services, *message.table, report); !answered)
            return tl::unexpected(answered.error());
    } else if (act == "reload") {
        JobSubmission accepted;
        accepted.kind = "reload";
        accepted.priority = Priority::high;
        accepted.job = std::make_unique<ReloadJob>(daemon, caller);
        return Answer{std::move(accepted)};
    } else if (act == "drain") {
        daemon.drain();
        report.text = "the daemon takes no more work and ends when its jobs have ended";
    } else if (act == "gc") {
        return collect_garbage(services, caller);
    } else {
        return refuse(Code::invalid_field, "unknown act '" + act +
                                               "': use one of connections, drain, reload, kick, "
                                               "quota, gc");
    }
    return answer_with(caller, report, services);
}

}  // namespace raynest::server
