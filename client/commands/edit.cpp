// raynest edit: moves parts of a scene, and changes their masks.
#include "client/commands/commands.h"
#include "client/commands/shared_options.h"
#include "client/ground/json.h"
#include "client/ground/numbers.h"
#include "client/output/output.h"
#include "client/requests/send_file.h"
#include "protocol/edit_row.h"

#include <algorithm>
#include <charconv>
#include <iostream>
#include <iterator>
#include <map>
#include <optional>
#include <string_view>

namespace raynest::client {
namespace {

using protocol::EditRow;

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

/// Reads PATH=NUMBERS or PATH=HEX; returns what is wrong, or "".
std::string read_change(EditRow::What what, const std::string& text, EditOptions& edit) {
    const std::size_t equals = text.rfind('=');
    if (equals == 0 || equals == std::string::npos) return "'" + text + "' is not PATH=...";
    EditChange change{what, text.substr(0, equals)};
    const std::string value = text.substr(equals + 1);
    if (what == EditRow::set_mask) {
        const auto mask = parse_mask(value);
        if (!mask) return mask.error().message;
        change.new_mask = *mask;
    } else {
        const bool is_move = what == EditRow::move;
        const auto numbers = parse_world(value, is_move ? 3 : 12, 12,
                                         is_move ? "dx,dy,dz or a 3x4 matrix row by row"
                                                 : "a 3x4 matrix row by row");
        if (!numbers) return numbers.error().message;
        if (numbers->size() == 3)
            for (std::size_t row = 0; row < 3; ++row) change.matrix[4 * row + 3] = (*numbers)[row];
        else
            std::ranges::copy(*numbers, change.matrix.begin());
    }
    edit.changes.push_back(std::move(change));
    return "";
}

}  // namespace

void declare(CommandLine& line, EditOptions& edit) {
    line.add_option("SCENE", edit.scene, "name of a loaded scene of yours").required();
    const auto changing = [&edit](EditRow::What what) {
        return [&edit, what](const std::string& text) { return read_change(what, text, edit); };
    };
    const auto set_mask = [&edit](std::uint32_t mask) {
        return [&edit, mask](const std::string& path) {
            EditChange change{EditRow::set_mask, path};
            change.new_mask = mask;
            edit.changes.push_back(std::move(change));
            return std::string();
        };
    };
    line.add_in_order(
        "--move", changing(EditRow::move),
        "PATH=DX,DY,DZ, or PATH= and a 3x4 matrix row by row: moves what stands there, in the world. In "
        "PATH * stands for any text, and all below a path moves with it; inst=N is the outermost "
        "instance N. May be repeated, also the options below; they act in their order");
    line.add_in_order("--place", changing(EditRow::place),
                      "PATH= and a 3x4 matrix row by row: from the object's own coordinates to the world's");
    line.add_in_order("--set-mask", changing(EditRow::set_mask),
                      "PATH=HEX: its mask from now on (see: query --mask)");
    line.add_in_order("--hide", set_mask(0), "PATH: no ray meets it from now on");
    line.add_in_order("--show", set_mask(~0U), "PATH: every ray may meet it");
    add_epoch(line, edit.epoch);
    line.at_end([&edit] {
        return edit.changes.empty() ? "--move, --place, --set-mask, --hide or --show is required"
                                    : std::string();
    });
}

Result<void> run(Context& context, const EditOptions& options) {
    wire::EditT request;
    request.scene = options.scene;
    request.epoch = options.epoch;
    std::map<std::string, std::uint32_t> known;
    std::vector<EditRow> rows;
    for (const EditChange& change : options.changes) {
        EditRow row{static_cast<std::uint32_t>(change.what), 0, 0, change.new_mask, {}};
        std::ranges::copy(change.matrix, std::begin(row.m));
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
