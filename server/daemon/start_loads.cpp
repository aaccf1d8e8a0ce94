#include "server/daemon/start_loads.h"

#include "server/daemon/notify.h"
#include "server/ground/log.h"
#include "server/options/load_sources.h"
#include "server/requests/load_at_start.h"
#include "server/store/scene_store.h"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <iterator>
#include <utility>

namespace raynest::server {
namespace {

constexpr std::chrono::milliseconds job_look{20};

void log_failure(const std::string& source, const std::string& reason) {
    log(LogLevel::error, "load_failed", {{"source", source}, {"reason", reason}});
}

}  // namespace

void StartLoads::start(const std::vector<std::string>& sources) {
    for (const std::string& source : sources) {
        std::vector<std::string> files = files_of(source);
        if (files.empty()) log_failure(source, "there is no such file");
        std::ranges::move(files, std::back_inserter(sources_));
    }
    load_next();
}

std::string StartLoads::unready() const {
    if (job_ == 0 && next_ == sources_.size()) return {};
    return "the daemon loads its scenes: " + std::to_string(next_ - (job_ != 0 ? 1 : 0)) + " of " +
           std::to_string(sources_.size()) + " have been loaded";
}

void StartLoads::load_next() {
    while (next_ < sources_.size()) {
        notify("STATUS=Loading " + sources_[next_]);
        if (begin(sources_[next_++])) return look();
    }
    if (!sources_.empty()) notify("STATUS=");
}

bool StartLoads::begin(const std::string& source) {
    caller_ = {};
    // The same principal as this user's on the Unix socket.
    caller_.identity.id = "uid:" + std::to_string(geteuid());
    caller_.identity.role = Role::admin;
    caller_.principal = caller_.identity.id;
    caller_.role = caller_.identity.role;
    caller_.connection = services_.scenes.connect();
    caller_.request_id = 1;
    auto load = load_at_start(services_, caller_, source);
    if (load) {
        const auto job =
            services_.detached.start(caller_.identity, caller_.request_id, std::move(*load));
        if (job) {
            job_ = (*job)->record().number;
            return true;
        }
        log_failure(source, job.error().message);
    } else {
        log_failure(source, load.error().message);
    }
    services_.scenes.disconnect(caller_);
    return false;
}

void StartLoads::look() {
    timer_.expires_after(job_look);
    timer_.async_wait([this](const SystemError& cancelled) {
        if (cancelled) return;
        const auto job = services_.detached.find(job_);
        if (job && (*job)->runner().size() != 0) return look();
        if (job) end_load(**job);
        job_ = 0;
        load_next();
    });
}

void StartLoads::end_load(const DetachedJob& job) {
    if (job.error()) log_failure(sources_[next_ - 1], job.error()->message);
    // Nobody fetches the answer. The scene stays by its name, without a connection that holds it.
    services_.detached.cancel(job.record().number);
    services_.scenes.disconnect(caller_);
}

}  // namespace raynest::server
