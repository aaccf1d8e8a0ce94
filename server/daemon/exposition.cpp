#include "server/daemon/exposition.h"

#include "engine/packs/registry.h"
#include "server/ground/log.h"
#include "server/requests/quota_use.h"
#include "server/scheduling/admission.h"
#include "server/scheduling/peers.h"
#include "server/store/scene_store.h"
#include "server/store/state_folder.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>
#include <string_view>
#include <vector>

namespace raynest::server {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

/// Most principals with rows of their own: Prometheus keeps each row that it ever saw.
constexpr std::size_t principals_max = 50;

const auto begun = std::chrono::system_clock::now();

/// Families in the order of their first values.
class Families {
public:
    void add(const char* name, MetricType type, std::string_view labels, std::string_view help,
             double value) {
        ClientMetric metric;
        if (const auto equals = labels.find('='); equals != std::string_view::npos)
            metric.label.push_back(
                {std::string(labels.substr(0, equals)), std::string(labels.substr(equals + 1))});
        (type == MetricType::Counter ? metric.counter.value : metric.gauge.value) = value;
        family(name, type, help).metric.push_back(std::move(metric));
    }
    MetricFamily& family(std::string_view name, MetricType type, std::string_view help) {
        const auto known = std::ranges::find(families_, name, &MetricFamily::name);
        if (known != families_.end()) return *known;
        MetricFamily made;
        made.name = name;
        made.help = description(name).empty() ? help : description(name);
        made.type = type;
        families_.push_back(std::move(made));
        return families_.back();
    }
    [[nodiscard]] std::string text() const {
        std::ostringstream out;
        prometheus::TextSerializer().Serialize(out, families_);
        return out.str();
    }

private:
    static std::string_view description(std::string_view name) {
#define RAYNEST_FAMILY(family, text) \
    if (name == #family) return text;
#include "server/ground/metrics.def"
        return {};
    }
    std::vector<MetricFamily> families_;
};

void add_build(const Services& services, Families& families) {
    ClientMetric build;
    build.label = {{"version", RAYNEST_VERSION},
                   {"isa", services.registry.variants().front().target}};
    build.gauge.value = 1;
    families.family("raynest_build_info", MetricType::Gauge, "the version that runs")
        .metric.push_back(std::move(build));
}

void add_rays(const RayCounts& counts, Families& families) {
    for (const auto& [labels, rays] : counts.rows()) {
        ClientMetric metric;
        metric.label = {{"kind", std::string(labels.kind)},
                        {"intersector", std::string(labels.intersector)},
                        {"backend", std::string(labels.backend)}};
        metric.counter.value = static_cast<double>(rays);
        families.family("raynest_rays_total", MetricType::Counter, "rays traced")
            .metric.push_back(std::move(metric));
    }
}

void add_durations(const DurationHistogram& durations, const char* name, const char* help,
                   Families& families) {
    ClientMetric metric;
    std::uint64_t sum = 0;
    for (std::size_t bin = 0; bin <= DurationHistogram::bounds_s.size(); ++bin) {
        sum += durations.count(bin);
        metric.histogram.bucket.push_back({sum, bin < DurationHistogram::bounds_s.size()
                                                    ? DurationHistogram::bounds_s[bin]
                                                    : std::numeric_limits<double>::infinity()});
    }
    metric.histogram.sample_count = sum;
    metric.histogram.sample_sum = durations.sum_s();
    families.family(name, MetricType::Histogram, help).metric.push_back(std::move(metric));
}

void add_principal(const Services& services, const std::string& principal, const QuotaUses& uses,
                   Families& families) {
    const auto add = [&](const char* name, MetricType type, std::string_view help,
                         ClientMetric::Label label, std::uint64_t value) {
        ClientMetric metric;
        metric.label.push_back({"principal", principal});
        if (!label.name.empty()) metric.label.push_back(std::move(label));
        (type == MetricType::Counter ? metric.counter.value : metric.gauge.value) =
            static_cast<double>(value);
        families.family(name, type, help).metric.push_back(std::move(metric));
    };
    const auto count = [&](const char* name, std::string_view help, ClientMetric::Label label,
                           Metrics::Counter Metrics::*counter) {
        add(name, MetricType::Counter, help, std::move(label),
            services.metrics.own.of(principal, position_of(counter)));
    };
    count("raynest_principal_rays_total", "rays traced for a principal", {}, &Metrics::rays);
    count("raynest_principal_jobs_total", "jobs started for a principal", {},
          &Metrics::jobs_started);
    constexpr const char* bytes = "bytes of a principal's frames, by direction";
    count("raynest_principal_bytes_total", bytes, {"direction", "received"},
          &Metrics::bytes_received);
    count("raynest_principal_bytes_total", bytes, {"direction", "sent"}, &Metrics::bytes_sent);
    for (const QuotaUse& use : uses) {
        const ClientMetric::Label label{"resource", std::string(use.resource)};
        add("raynest_principal_used", MetricType::Gauge, "what a principal uses of its quotas",
            label, use.used);
        add("raynest_principal_quota", MetricType::Gauge, "the quotas of a principal", label,
            use.quota);
    }
}

void add_principals(const Services& services, const Principal& reader, Families& families) {
    const auto shown = reader.role == Role::admin ? services.metrics.own.latest(principals_max)
                                                  : std::vector<std::string>{reader.id};
    const auto uses = quota_uses(services, shown);
    for (const std::string& principal : shown)
        add_principal(services, principal, uses.at(principal), families);
}

void add_state(const Services& services, Families& families) {
    const StateFolder& state = *services.state;
    families.add("raynest_state_bytes", MetricType::Gauge, "",
                 "bytes of stored scenes and kept edits",
                 static_cast<double>(services.scenes.stored_bytes()));
    std::error_code error;
    if (const auto space = std::filesystem::space(state.path(), error); !error)
        families.add("raynest_state_free_bytes", MetricType::Gauge, "",
                     "free bytes of the state folder's disk", static_cast<double>(space.available));
    families.add("raynest_state_failed", MetricType::Gauge, "",
                 "1 if the disk has failed: nothing more is stored before a restart",
                 state.stores() ? 0 : 1);
    add_durations(state.commits(), "raynest_state_commit_seconds",
                  "time of the commits that loads and kept edits wait for", families);
}

/// The names that Prometheus' client libraries give to these.
void add_process(Families& families) {
    families.add("process_start_time_seconds", MetricType::Gauge, "", "Unix time of the start",
                 std::chrono::duration<double>(begun.time_since_epoch()).count());
    rusage used{};
    if (getrusage(RUSAGE_SELF, &used) == 0) {
        const auto seconds_of = [](const timeval& time) {
            return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
        };
        families.add("process_cpu_seconds_total", MetricType::Counter, "",
                     "user and system CPU time",
                     seconds_of(used.ru_utime) + seconds_of(used.ru_stime));
    }
    std::ifstream statm("/proc/self/statm");
    std::uint64_t pages = 0;
    std::uint64_t resident = 0;
    if (statm >> pages >> resident)
        families.add(
            "process_resident_memory_bytes", MetricType::Gauge, "",
            "resident memory; what several epochs of a scene share counts for each of them",
            static_cast<double>(resident) * static_cast<double>(sysconf(_SC_PAGESIZE)));
    std::error_code error;
    const std::filesystem::directory_iterator open("/proc/self/fd", error);
    if (!error)
        families.add("process_open_fds", MetricType::Gauge, "", "open file descriptors",
                     static_cast<double>(std::distance(begin(open), end(open))));
    rlimit limit{};
    if (getrlimit(RLIMIT_NOFILE, &limit) == 0)
        families.add("process_max_fds", MetricType::Gauge, "", "open file descriptors, at most",
                     static_cast<double>(limit.rlim_cur));
}

}  // namespace

std::string exposition(const Services& services, const Principal& reader,
                       std::optional<double> certificate_days_left) {
    Families families;
    add_build(services, families);
#define RAYNEST_METRIC(name, family, labels, text)           \
    families.add(#family, MetricType::Counter, labels, text, \
                 static_cast<double>(services.metrics.name.load()));
#define RAYNEST_GAUGE(name, value, family, labels, text) \
    families.add(#family, MetricType::Gauge, labels, text, static_cast<double>(value));
#include "server/ground/metrics.def"
    if (certificate_days_left)
        families.add("raynest_tls_certificate_days_left", MetricType::Gauge, "",
                     "days until the certificate of tls:// expires", *certificate_days_left);
    const Metrics& metrics = services.metrics;
    add_rays(metrics.rays_by_label, families);
    add_durations(metrics.job_seconds, "raynest_request_duration_seconds",
                  "time from the start of a job to its end", families);
    add_durations(metrics.cancel_seconds, "raynest_cancel_latency_seconds",
                  "time from the cancellation of a job to the end of its last task", families);
    add_durations(metrics.load_seconds, "raynest_scene_load_duration_seconds",
                  "time from the request for a scene to its publication", families);
    if (services.state != nullptr) add_state(services, families);
    add_principals(services, reader, families);
    add_process(families);
    return families.text();
}

}  // namespace raynest::server
