// raynest edit: moves parts of a scene, and changes their masks.
#include "client/commands/commands.h"
#include "client/job.h"
#include "client/output.h"
#include "client/send_file.h"

#include <charconv>
#include <cstring>
#include <iostream>
#include <map>
#include <optional>
#include <string_view>

namespace raynest::client {
namespace {

/// A row of an edit, as messages.fbs has it.
struct Row {
    std::uint32_t what;
    std::uint32_t target;
    std::uint32_t by_text;
    std::uint32_t mask;
    std::array<double, 12> matrix;
};
static_assert(sizeof(Row) == 112);

/// Returns N of "inst=N".
std::optional<std::uint32_t> instance_of(std::string_view path) {
    constexpr std::string_view key = "inst=";
    if (!path.starts_with(key)) return std::nullopt;
    path.remove_prefix(key.size());
    std::uint32_t number = 0;
    const auto [end, error] = std::from_chars(path.data(), path.data() + path.size(), number);
    if (error != std::errc{} || end != path.data() + path.size()) return std::nullopt;
    return number;
}

}  // namespace

Result<void> run(Context& context, const EditOptions& options) {
    wire::EditT request;
    request.scene = options.scene;
    request.epoch = options.epoch;
    std::map<std::string, std::uint32_t> known;
    std::vector<Row> rows;
    for (const EditChange& change : options.changes) {
        Row row{static_cast<std::uint32_t>(change.what), 0, 0, change.new_mask, change.matrix};
        if (const auto instance = instance_of(change.path)) {
            row.target = *instance;
        } else {
            const auto [at, added] =
                known.emplace(change.path, static_cast<std::uint32_t>(request.targets.size()));
            if (added) request.targets.push_back(change.path);
            row.target = at->second;
            row.by_text = 1;
        }
        rows.push_back(row);
    }
    request.rows = static_cast<std::uint32_t>(rows.size());
    if (auto started = context.connection.start(request); !started) return started;
    const FrameConsumer ignore = [](const protocol::Frame&) { return Result<void>(); };
    if (auto sent = send_file(context.connection, 0, std::as_bytes(std::span(rows)),
                              context.progress, ignore);
        !sent)
        return sent;
    while (true) {
        const auto frame = context.connection.next();
        if (!frame) return tl::unexpected<Failure>(frame.error());
        const auto edited = protocol::open<wire::Edited>(*frame);
        if (!edited) continue;  // news of its progress
        context.progress.clear();
        const wire::Edited& done = *edited->table;
        if (context.json) {
            print_json(Json{{"scene", options.scene},
                            {"epoch", done.epoch()},
                            {"hash", protocol::text(done.hash())},
                            {"instances", done.instances()},
                            {"refits", done.refits()},
                            {"rebuilds", done.rebuilds()},
                            {"seconds", done.seconds()}});
            return {};
        }
        std::cout << options.scene << " is at epoch " << done.epoch() << ": " << done.instances()
                  << (done.instances() == 1 ? " instance has changed\n" : " instances have changed\n");
        return {};
    }
}

}  // namespace raynest::client
