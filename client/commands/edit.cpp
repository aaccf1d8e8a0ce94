// raynest edit: parts of a scene move, hide, go and come.
#include "client/arguments/shared_options.h"
#include "client/commands/commands.h"
#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/ground/numbers.h"
#include "client/output/output.h"
#include "client/requests/send_file.h"
#include "protocol/control.h"
#include "protocol/edit_row.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <iostream>
#include <iterator>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace raynest::client {
namespace {

using protocol::EditRow;

std::optional<std::uint32_t> parse_whole(std::string_view text) {
    std::uint32_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    return number;
}

/// Returns N of "inst=N", where that is the key.
std::optional<std::uint32_t> number_of(std::string_view path, std::string_view key) {
    return path.starts_with(key) ? parse_whole(path.substr(key.size())) : std::nullopt;
}

/// A change that a user may name: --move on the command line, move in a file.
struct Word {
    std::string_view name;
    EditRow::What what;
    std::uint32_t value;      ///< the frame of a matrix, or the mask
    std::string_view wanted;  ///< behind PATH=; "" where the path is all
    const char* text;
};
constexpr std::string_view a_mask = "a mask";
constexpr std::string_view a_uid = "a user id";
constexpr std::string_view a_material = "a material";
constexpr std::string_view a_matrix = "a 3x4 matrix row by row";
constexpr std::string_view a_move = "x,y,z or a 3x4 matrix row by row";
constexpr std::array<Word, 10> words{{
    {"move", EditRow::move, EditRow::world, a_move,
     "PATH=DX,DY,DZ, or PATH= and a 3x4 matrix row by row: moves what is at PATH, in the world. "
     "In PATH * stands for any text, and all below a path moves with it; inst=N is the outermost "
     "instance N, uid=N what has the user id N. This option and those below may be repeated; they "
     "act in the order given, except that --add and --remove act last"},
    {"turn", EditRow::move, EditRow::own, a_move,
     "PATH= as for --move, in the coordinates of the object itself: a wheel about its axle"},
    {"place", EditRow::place, EditRow::world, a_matrix,
     "PATH= and a 3x4 matrix row by row: from the object's own coordinates to the world's"},
    {"add", EditRow::add, ~0U, a_move,
     "SCENE=X,Y,Z, or SCENE= and a 3x4 matrix: adds the loaded scene SCENE at that place. Its "
     "paths begin with its name; several of one name have numbers, as SCENE#0"},
    {"remove", EditRow::remove, 0, "", "PATH: removes the outermost instances at PATH"},
    {"set-mask", EditRow::set_mask, 0, a_mask,
     "PATH=HEX: sets the mask of what is at PATH (see: query --mask)"},
    {"set-uid", EditRow::set_uid, 0, a_uid,
     "PATH=NUMBER: sets the user id of what is at PATH, and of all within it"},
    {"set-material", EditRow::set_material, 0, a_material,
     "PATH=NAME: gives the meshes at PATH, and all within them, a material of the scene: its "
     "name, or its number in the column material"},
    {"hide", EditRow::set_mask, 0, "", "PATH: hides what is at PATH from all rays"},
    {"show", EditRow::set_mask, ~0U, "", "PATH: shows what is at PATH to all rays"},
}};

/// Reads what stands behind a word; returns what is wrong, or "".
std::string read_change(const Word& word, const std::string& text, EditOptions& edit) {
    EditChange change{word.what, text, word.value, {}};
    if (!word.wanted.empty()) {
        const std::size_t equals = text.rfind('=');
        if (equals == 0 || equals == std::string::npos) return "'" + text + "' is not PATH=...";
        change.path = text.substr(0, equals);
        const std::string value = text.substr(equals + 1);
        if (word.wanted == a_mask) {
            const auto mask = parse_mask(value);
            if (!mask) return mask.error().message;
            change.value = *mask;
        } else if (word.wanted == a_uid) {
            const auto uid = parse_whole(value);
            if (!uid) return "'" + value + "' is no user id, a whole number below 4294967295";
            change.value = *uid;
        } else if (word.wanted == a_material) {
            if (value.empty()) return "a material is missing";
            change.material = value;
        } else {
            const auto numbers = parse_world(value, word.wanted == a_move ? 3 : 12, 12,
                                             std::string(word.wanted).c_str());
            if (!numbers) return numbers.error().message;
            if (numbers->size() == 3)
                for (std::size_t row = 0; row < 3; ++row)
                    change.matrix[4 * row + 3] = (*numbers)[row];
            else
                std::ranges::copy(*numbers, change.matrix.begin());
        }
    }
    if (change.path.empty()) return "a PATH is missing";
    edit.changes.push_back(std::move(change));
    return "";
}

/// Reads a file of changes, one a line: "move PATH=1,0,0". Empty lines, and those that begin with
/// #, say nothing.
std::string read_changes(const std::string& path, EditOptions& edit) {
    constexpr std::uint64_t bytes_max = 64 << 20;
    const auto file = read_file(path, bytes_max);
    if (!file) return file.error().message;
    std::istringstream lines(
        std::string(reinterpret_cast<const char*>(file->data()), file->size()));
    std::string line;
    for (int number = 1; std::getline(lines, line); ++number) {
        if (line.find_first_not_of(" \t\r") == std::string::npos || line.front() == '#') continue;
        if (line.back() == '\r') line.pop_back();
        const std::size_t space = line.find(' ');
        const auto word =
            std::ranges::find(words, std::string_view(line).substr(0, space), &Word::name);
        const std::string wrong =
            word == words.end() || space == std::string::npos
                ? "'" + line.substr(0, 60) +
                      "' does not begin with one of move, turn, place, add, remove, "
                      "set-mask, set-uid, set-material, hide, show and a space"
                : read_change(*word, line.substr(space + 1), edit);
        if (!wrong.empty()) return "line " + std::to_string(number) + " of " + path + ": " + wrong;
    }
    return "";
}

}  // namespace

void declare(CommandLine& line, EditOptions& edit) {
    line.add_option("SCENE", edit.scene, "name of a loaded scene of yours").required();
    for (const Word& word : words)
        line.add_in_order(
            std::string("--").append(word.name),
            [&edit, &word](const std::string& text) { return read_change(word, text, edit); },
            word.text);
    line.add_in_order(
        "--file", [&edit](const std::string& path) { return read_changes(path, edit); },
        "File of changes, one a line, as these options without their dashes: move PATH=DX,DY,DZ");
    line.add_flag("--keep", edit.keep,
                  "keep the edited scene through a restart, in a daemon with --state. Without this "
                  "option a restart brings back what was loaded or kept last");
    add_epoch(line, edit.epoch);
    line.at_end([&edit] {
        return edit.changes.empty() ? "--move, --turn, --place, --add, --remove, --set-mask, "
                                      "--set-uid, --set-material, --hide, --show "
                                      "or --file is required"
                                    : std::string();
    });
}

Result<void> run(Context& context, const EditOptions& options) {
    wire::EditT request;
    request.scene = options.scene;
    request.epoch = options.epoch;
    request.keep = options.keep;
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
        if (change.what == EditRow::set_material)
            row.value = place_in(request.materials, change.material);
        if (change.what == EditRow::add) {
            row.target = place_in(request.scenes, change.path);
        } else if (const auto instance = number_of(change.path, "inst=")) {
            row.target = *instance;
        } else if (const auto uid = number_of(change.path, "uid=")) {
            row.target = *uid;
            row.by = EditRow::uid;
        } else {
            row.target = place_in(request.targets, change.path);
            row.by = EditRow::text;
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
        if (!is<wire::Edited>(*frame)) continue;  // news of its progress
        const auto edited = open_sent<wire::Edited>(*frame);
        if (!edited) return tl::unexpected<Failure>(edited.error());
        context.progress.clear();
        const wire::Edited& done = *edited->table;
        const std::vector<std::string> notes = protocol::strings(done.notes());
        if (context.json) {
            print_json(Json{{"scene", options.scene},
                            {"epoch", done.epoch()},
                            {"hash", protocol::text(done.hash())},
                            {"instances", done.instances()},
                            {"refits", done.refits()},
                            {"rebuilds", done.rebuilds()},
                            {"kept", done.kept()},
                            {"seconds", done.seconds()},
                            {"notes", notes}});
            return {};
        }
        for (const std::string& note : notes) print_note(note);
        std::cout << options.scene << " is at epoch " << done.epoch() << ": " << done.instances()
                  << (done.instances() == 1 ? " instance has changed" : " instances have changed")
                  << (done.kept() ? ", kept\n" : "\n");
        return {};
    }
}

}  // namespace raynest::client
