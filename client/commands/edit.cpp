// raynest edit: parts of a scene move, hide, go and come.
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
std::string read_change(EditRow::What what, EditRow::Frame frame, const std::string& text,
                        EditOptions& edit) {
    const std::size_t equals = text.rfind('=');
    if (equals == 0 || equals == std::string::npos) return "'" + text + "' is not PATH=...";
    EditChange change{what, text.substr(0, equals), frame};
    const std::string value = text.substr(equals + 1);
    if (what == EditRow::set_mask) {
        const auto mask = parse_mask(value);
        if (!mask) return mask.error().message;
        change.value = *mask;
    } else {
        const bool may_shift = what != EditRow::place;
        const auto numbers = parse_world(value, may_shift ? 3 : 12, 12,
                                         may_shift ? "x,y,z or a 3x4 matrix row by row"
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
    const auto changing = [&edit](EditRow::What what, EditRow::Frame frame = EditRow::world) {
        return [&edit, what, frame](const std::string& text) { return read_change(what, frame, text, edit); };
    };
    const auto setting = [&edit](EditRow::What what, std::uint32_t value) {
        return [&edit, what, value](const std::string& path) {
            edit.changes.push_back(EditChange{what, path, value});
            return std::string();
        };
    };
    line.add_in_order(
        "--move", changing(EditRow::move),
        "PATH=DX,DY,DZ, or PATH= and a 3x4 matrix row by row: moves what stands there, in the world. In "
        "PATH * stands for any text, and all below a path moves with it; inst=N is the outermost "
        "instance N. May be repeated, also the options below; they act in their order");
    line.add_in_order("--turn", changing(EditRow::move, EditRow::own),
                      "PATH= as for --move, in the coordinates of the object itself: a wheel about its axle");
    line.add_in_order("--place", changing(EditRow::place),
                      "PATH= and a 3x4 matrix row by row: from the object's own coordinates to the world's");
    line.add_in_order("--add", changing(EditRow::add),
                      "SCENE=X,Y,Z, or SCENE= and a 3x4 matrix: adds the loaded scene SCENE, there. Its path "
                      "begins with its name, and where there are several, with a number");
    line.add_in_order("--remove", setting(EditRow::remove, 0), "PATH: removes the outermost instances there");
    line.add_in_order("--set-mask", changing(EditRow::set_mask),
                      "PATH=HEX: its mask from now on (see: query --mask)");
    line.add_in_order("--hide", setting(EditRow::set_mask, 0), "PATH: no ray meets it from now on");
    line.add_in_order("--show", setting(EditRow::set_mask, ~0U), "PATH: every ray may meet it");
    add_epoch(line, edit.epoch);
    line.at_end([&edit] {
        return edit.changes.empty() ? "--move, --turn, --place, --add, --remove, --set-mask, --hide or --show "
                                      "is required"
                                    : std::string();
    });
}

Result<void> run(Context& context, const EditOptions& options) {
    wire::EditT request;
    request.scene = options.scene;
    request.epoch = options.epoch;
    // The places of texts in a list of the request, each once.
    const auto place_in = [](std::vector<std::string>& list, const std::string& text) {
        const auto at = std::ranges::find(list, text);
        if (at == list.end()) list.push_back(text);
        return static_cast<std::uint32_t>(std::ranges::find(list, text) - list.begin());
    };
    std::vector<EditRow> rows;
    for (const EditChange& change : options.changes) {
        EditRow row{static_cast<std::uint32_t>(change.what), 0, 0, change.value, {}};
        std::ranges::copy(change.matrix, std::begin(row.m));
        if (change.what == EditRow::add) {
            row.target = place_in(request.scenes, change.path);
            row.value = ~0U;
        } else if (const auto instance = instance_of(change.path)) {
            row.target = *instance;
        } else {
            row.target = place_in(request.targets, change.path);
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
