// raynest top: what the daemon works on, looked at once a second.
#include "client/commands/command.h"
#include "client/ground/interrupt.h"
#include "client/ground/json.h"
#include "client/ground/text.h"
#include "client/output/job_text.h"
#include "client/output/output.h"
#include "client/requests/listings.h"

#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <iostream>
#include <map>
#include <string_view>
#include <thread>

namespace raynest::client {
namespace {

struct TopOptions {
    bool once = false;  ///< one look, and the end
};

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds period{1000};
/// Longest sleep between two checks for Ctrl-C.
constexpr std::chrono::milliseconds nap{50};

/// Counters whose names hold one of these count what the daemon refused or cut off.
constexpr std::array<std::string_view, 10> refusal_words = {
    "refus", "gave_way", "timeout", "cut_off",  "foreign",
    "bad_",  "fault",    "kill",    "deadline", "failed"};

/// The daemon's counters at one moment.
struct Sample {
    Clock::time_point at;
    std::vector<std::string> names;  ///< in the daemon's order
    std::map<std::string, double> values;
    [[nodiscard]] bool has(const std::string& name) const { return values.contains(name); }
    [[nodiscard]] double value(const std::string& name) const {
        const auto found = values.find(name);
        return found == values.end() ? 0 : found->second;
    }
};

Result<Sample> take_sample(Connection& connection) {
    const auto reply = ask<wire::Statistics>(connection, wire::StatsT{});
    if (!reply) return tl::unexpected<Failure>(reply.error());
    Sample sample{Clock::now(), protocol::strings((*reply)->names()), {}};
    for (std::size_t i = 0; i < sample.names.size(); ++i)
        sample.values[sample.names[i]] =
            (*reply)->values()->Get(static_cast<flatbuffers::uoffset_t>(i));
    return sample;
}

/// Sleeps until the next look; false if Ctrl-C came.
bool wait_until(Clock::time_point end) {
    while (Clock::now() < end) {
        if (interrupted()) return false;
        std::this_thread::sleep_for(std::min<Clock::duration>(nap, end - Clock::now()));
    }
    return !interrupted();
}

bool is_refusal(std::string_view name) {
    for (const std::string_view word : refusal_words)
        if (name.find(word) != std::string_view::npos) return true;
    return false;
}

/// A principal's part of the daemon, as far as this client may see it.
struct PrincipalUse {
    std::string role;  ///< empty: only administrators are told
    std::uint64_t connections = 0;
    std::uint64_t jobs = 0;
    std::uint64_t scenes = 0;
    std::uint64_t scene_bytes = 0;
};

/// One look: two samples a second apart, the jobs and the scenes.
struct Look {
    double seconds = 0;  ///< between the samples
    Sample before, now;
    std::vector<std::vector<std::string>> job_rows;
    Json jobs = Json::array();
    std::uint64_t running = 0;
    std::uint64_t waiting = 0;  ///< running ones with nothing done yet
    std::vector<ListedScene> scenes;
    std::map<std::string, PrincipalUse> principals;
    [[nodiscard]] double rate(const std::string& name) const {
        return seconds > 0 ? (now.value(name) - before.value(name)) / seconds : 0;
    }
};

/// Only administrators may ask for the connections.
Result<void> count_connections(Connection& connection,
                               std::map<std::string, PrincipalUse>& principals) {
    return each_connection(connection, [&](const ListedConnection& row) {
        PrincipalUse& use = principals[row.principal];
        use.role = row.role;
        ++use.connections;
    });
}

Result<Look> take_look(Connection& connection, const Sample& before) {
    auto now = take_sample(connection);
    if (!now) return tl::unexpected<Failure>(now.error());
    Look look;
    look.before = before;
    look.now = std::move(*now);
    look.seconds = std::chrono::duration<double>(look.now.at - before.at).count();
    look.job_rows.push_back(job_header());
    const auto listed = each_job(connection, [&](const wire::JobInfo& info) {
        if (protocol::text(info.state()) != "running") return;
        ++look.running;
        if (info.done() == 0) ++look.waiting;
        ++look.principals[std::string(protocol::text(info.owner()))].jobs;
        look.jobs.push_back(job_json(info));
        look.job_rows.push_back(job_row(info));
    });
    if (!listed) return tl::unexpected<Failure>(listed.error());
    auto scenes = list_scenes(connection);
    if (!scenes) return tl::unexpected<Failure>(scenes.error());
    look.scenes = std::move(*scenes);
    for (const ListedScene& scene : look.scenes) {
        PrincipalUse& owner = look.principals[scene.owner];
        ++owner.scenes;
        owner.scene_bytes += scene.bytes;
    }
    if (connection.daemon().role == "admin")
        if (auto counted = count_connections(connection, look.principals); !counted)
            return tl::unexpected<Failure>(counted.error());
    return look;
}

std::string rate_text(double per_second) {
    std::array<char, 48> text{};
    if (per_second >= 1e6)
        std::snprintf(text.data(), text.size(), "%.2f M", per_second / 1e6);
    else if (per_second >= 1e3)
        std::snprintf(text.data(), text.size(), "%.1f k", per_second / 1e3);
    else
        std::snprintf(text.data(), text.size(), "%.0f ", per_second);
    return text.data();
}

void print_look(const Look& look, const std::string& daemon, bool sees_all) {
    const auto bytes = [&](const char* name) {
        return bytes_text(static_cast<std::uint64_t>(look.now.value(name)));
    };
    std::cout << daemon << ": " << look.running << (look.running == 1 ? " job" : " jobs")
              << ", queue " << look.waiting << ", " << rate_text(look.rate("rays")) << "rays/s";
    if (look.rate("scenes_edited") > 0)
        std::cout << ", " << rate_text(look.rate("scenes_edited")) << "edits/s";
    // Others than administrators are told their own part.
    if (look.now.has("memory_used_bytes"))
        std::cout << (sees_all ? ", memory " : ", your memory ") << bytes("memory_used_bytes")
                  << " of " << bytes("memory_limit_bytes");
    std::cout << "\n\n";
    if (look.running != 0) {
        print_table(look.job_rows);
        std::cout << '\n';
    }
    if (!look.principals.empty()) {
        std::vector<std::vector<std::string>> rows = {
            {"PRINCIPAL", "ROLE", "CONNECTIONS", "JOBS", "SCENES", "MEMORY"}};
        for (const auto& [name, use] : look.principals)
            rows.push_back({name, use.role.empty() ? "-" : use.role,
                            use.role.empty() ? "-" : std::to_string(use.connections),
                            std::to_string(use.jobs), std::to_string(use.scenes),
                            bytes_text(use.scene_bytes)});
        print_table(rows);
        std::cout << '\n';
    }
    if (!look.scenes.empty()) {
        std::vector<std::vector<std::string>> rows = {
            {"SCENE", "EPOCH", "TRIANGLES", "MEMORY", "OWNER", "UNUSED", "OPEN"}};
        for (const ListedScene& scene : look.scenes)
            rows.push_back({scene.name, std::to_string(scene.epoch), grouped(scene.triangles),
                            bytes_text(scene.bytes), scene.owner, age_text(scene.idle_seconds),
                            std::to_string(scene.holders)});
        print_table(rows);
        std::cout << '\n';
    }
    std::vector<std::vector<std::string>> rows = {{"REFUSED", "TOTAL", "PER SECOND"}};
    for (const std::string& name : look.now.names) {
        const double total = look.now.value(name);
        if (is_refusal(name) && total > 0)
            rows.push_back(
                {name, grouped(static_cast<std::uint64_t>(total)), rate_text(look.rate(name))});
    }
    if (rows.size() == 1)
        std::cout << "nothing was refused\n";
    else
        print_table(rows);
}

Json look_json(const Look& look) {
    Json scenes = Json::array();
    for (const ListedScene& scene : look.scenes)
        scenes.push_back(Json{{"name", scene.name},
                              {"epoch", scene.epoch},
                              {"instanced_triangles", scene.triangles},
                              {"bytes", scene.bytes},
                              {"owner", scene.owner},
                              {"idle_seconds", scene.idle_seconds},
                              {"holders", scene.holders}});
    Json refused = Json::object();
    for (const std::string& name : look.now.names)
        if (is_refusal(name)) refused[name] = look.now.value(name);
    Json principals = Json::array();
    for (const auto& [name, use] : look.principals) {
        const bool is_told = !use.role.empty();
        principals.push_back(Json{{"principal", name},
                                  {"role", is_told ? Json(use.role) : Json(nullptr)},
                                  {"connections", is_told ? Json(use.connections) : Json(nullptr)},
                                  {"jobs", use.jobs},
                                  {"scenes", use.scenes},
                                  {"scene_bytes", use.scene_bytes}});
    }
    const auto known = [&](const char* name) {
        return look.now.has(name) ? Json(look.now.value(name)) : Json(nullptr);
    };
    return Json{{"seconds", look.seconds},
                {"jobs_running", look.running},
                {"queue", look.waiting},
                {"rays_per_second", look.rate("rays")},
                {"edits_per_second", look.rate("scenes_edited")},
                {"memory_used_bytes", known("memory_used_bytes")},
                {"memory_limit_bytes", known("memory_limit_bytes")},
                {"principals", principals},
                {"jobs", look.jobs},
                {"scenes", scenes},
                {"refused", refused}};
}

}  // namespace

void declare(CommandLine& line, TopOptions& top) {
    line.add_flag("--once", top.once, "print one second's figures and exit");
}

Result<void> run(Context& context, const TopOptions& options) {
    const bool redraws = !context.json && !options.once && ::isatty(STDOUT_FILENO) == 1;
    auto before = take_sample(context.connection);
    if (!before) return tl::unexpected<Failure>(before.error());
    for (bool first = true;; first = false) {
        // Ctrl-C is how one leaves; no job ends with it.
        if (!wait_until(before->at + period)) return {};
        auto look = take_look(context.connection, *before);
        if (!look) {
            if (interrupted()) return {};
            return tl::unexpected<Failure>(look.error());
        }
        if (context.json) {
            print_json(look_json(*look));
        } else {
            // Home, the look, and nothing of the last one below it.
            if (redraws) std::cout << "\x1b[H\x1b[2J";
            if (!redraws && !first) std::cout << '\n';
            print_look(*look, context.connection.daemon().name,
                       context.connection.daemon().role == "admin");
        }
        std::cout.flush();
        if (auto written = check_stdout(); !written) return written;
        if (options.once) return {};
        *before = std::move(look->now);
    }
}

namespace {

class Top final : public CommandOf<TopOptions> {
    [[nodiscard]] bool needs_lasting_daemon() const override { return true; }
    [[nodiscard]] bool prints_looks() const override { return true; }
};

}  // namespace

std::unique_ptr<Command> make_top() {
    return std::make_unique<Top>();
}

}  // namespace raynest::client
