// raynest edit: parts of a scene move, hide, go and come.
#include "client/arguments/shared_options.h"
#include "client/commands/command.h"
#include "client/files/files.h"
#include "client/ground/json.h"
#include "client/ground/numbers.h"
#include "client/output/output.h"
#include "client/requests/picture.h"
#include "client/requests/send_file.h"
#include "protocol/control.h"
#include "protocol/edit_row.h"
#include "protocol/limits.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <functional>
#include <iostream>
#include <iterator>
#include <map>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace raynest::client {
namespace {

/// A change of a scene.
struct EditChange {
    protocol::EditRow::What what = protocol::EditRow::move;
    std::string path;         ///< a text, '*' for any text, or inst=N; of add the name of a scene
    std::uint32_t value = 0;  ///< a mask, the frame of place and move, or a user id
    std::string material{};   ///< for set_material: its name or number
    std::array<double, 12> matrix{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};  ///< for place, move and add
    std::string said{};  ///< where: "line 3 of FILE", or the option
};
struct EditOptions {
    std::string scene;
    std::uint64_t epoch = 0;  ///< 0: the current one
    std::vector<EditChange> changes;
    std::optional<Failure> bad_file;  ///< the first that cannot be read
    bool keep = false;                ///< answered when it outlives the daemon
};

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
constexpr std::size_t shown_max = 60;  // letters of what a user said, in an error
constexpr std::uint64_t file_bytes_max = 64 << 20;
// The bytes of all texts that are sent: other lists, and the message itself, take room too.
constexpr std::size_t texts_bytes_max = protocol::Limits{}.control_bytes_max / 2;
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

/// Reads what stands behind a word; returns what is wrong, or "". `said` is where it stands.
std::string read_change(const Word& word, const std::string& text, std::string said,
                        EditOptions& edit) {
    EditChange change{word.what, text, word.value, {}};
    change.said = std::move(said);
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
Result<void> read_changes(const std::string& path, EditOptions& edit) {
    constexpr std::string_view byte_order_mark = "\xEF\xBB\xBF";  // from editors on Windows
    constexpr const char* blanks = " \t\r";
    const auto file = read_file(path, file_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    std::string_view text(reinterpret_cast<const char*>(file->data()), file->size());
    if (text.starts_with(byte_order_mark)) text.remove_prefix(byte_order_mark.size());
    std::istringstream lines{std::string(text)};
    std::string line;
    for (int number = 1; std::getline(lines, line); ++number) {
        line.erase(0, line.find_first_not_of(blanks));
        line.erase(line.find_last_not_of(blanks) + 1);
        if (line.empty() || line.front() == '#') continue;
        const std::size_t space = line.find_first_of(blanks);
        const auto word =
            std::ranges::find(words, std::string_view(line).substr(0, space), &Word::name);
        const std::string said = "line " + std::to_string(number) + " of " + shown_name(path);
        const std::string wrong =
            word == words.end() || space == std::string::npos
                ? "'" + line.substr(0, shown_max) +
                      "' does not begin with one of move, turn, place, add, remove, "
                      "set-mask, set-uid, set-material, hide, show and a space"
                : read_change(*word, line.substr(line.find_first_not_of(blanks, space)), said,
                              edit);
        if (!wrong.empty()) return fail(Exit::invalid, said + ": " + wrong);
    }
    return {};
}

/// The outermost instance of the placements that a text names, if they are all of one instance.
struct Named {
    std::uint32_t instance = 0;
    std::uint64_t placements = 0;
    bool is_one = true;
};

/// Returns the numbers of the outermost instances that one of these texts names as a whole, and
/// makes `epoch` that of the numbers.
Result<std::map<std::string, std::uint32_t>> numbers_of(Context& context,
                                                        const std::vector<std::string>& texts,
                                                        const std::string& scene,
                                                        std::uint64_t& epoch) {
    constexpr std::uint64_t searched_max = 1 << 20;
    std::map<std::string, Named, std::less<>> named;
    for (const std::string& text : texts) named.try_emplace(text);
    std::map<std::uint32_t, std::uint64_t> placements;  // each outermost instance's
    wire::StructureT request;
    request.scene = scene;
    request.kind = "placements";
    request.count = static_cast<std::uint32_t>(protocol::Limits{}.structure_rows_max);
    for (std::uint64_t total = 1; request.first < total;) {
        request.epoch = epoch;
        if (auto started = context.connection.start(request); !started)
            return tl::unexpected<Failure>(started.error());
        const auto answer = receive_file(context.connection, context.progress, document_room());
        if (!answer) return tl::unexpected<Failure>(answer.error());
        const auto document = read_json(*answer);
        if (!document) return tl::unexpected<Failure>(document.error());
        total = document->at("total").get<std::uint64_t>();
        epoch = document->at("epoch").get<std::uint64_t>();
        const Json& rows = document->at("rows");
        if (total > searched_max || rows.empty()) break;
        request.first += rows.size();
        for (const Json& row : rows) {
            const auto name = row.at("name").get<std::string>();
            if (row.at("instance").is_null()) continue;
            const auto instance = row.at("instance").get<std::uint32_t>();
            ++placements[instance];
            for (std::size_t end = 0; end != std::string::npos;) {
                end = name.find('/', end + 1);
                const auto found = named.find(std::string_view(name).substr(0, end));
                if (found == named.end()) continue;
                Named& is = found->second;
                if (is.placements++ == 0) is.instance = instance;
                is.is_one = is.is_one && is.instance == instance;
            }
        }
    }
    std::map<std::string, std::uint32_t> numbers;
    for (const auto& [text, is] : named)
        if (is.placements != 0 && is.is_one && is.placements == placements[is.instance])
            numbers.emplace(text, is.instance);
    return numbers;
}

/// A list of a request, in which each text stands once.
struct TextList {
    std::vector<std::string>& texts;
    std::map<std::string, std::uint32_t> places{};

    std::uint32_t place_of(const std::string& text) {
        const auto [at, is_new] =
            places.try_emplace(text, static_cast<std::uint32_t>(texts.size()));
        if (is_new) texts.push_back(text);
        return at->second;
    }
};

/// True for what targets name by a text.
bool is_text(const EditChange& change) {
    return change.what != EditRow::add && !number_of(change.path, "inst=") &&
           !number_of(change.path, "uid=");
}

/// Returns the numbers of targets where their texts are more than a message may have.
Result<std::map<std::string, std::uint32_t>> spare_texts(Context& context,
                                                         const EditOptions& options,
                                                         std::uint64_t& epoch) {
    const protocol::Limits limits;
    const auto fit = [&](const std::vector<std::string>& texts) {
        std::size_t bytes = 0;
        for (const std::string& text : texts) bytes += text.size();
        return texts.size() <= limits.list_items_max && bytes <= texts_bytes_max;
    };
    std::vector<std::string> texts;
    TextList list{texts};
    for (const EditChange& change : options.changes)
        if (is_text(change)) list.place_of(change.path);
    if (fit(texts)) return std::map<std::string, std::uint32_t>();
    auto numbers = numbers_of(context, texts, options.scene, epoch);
    if (!numbers) return numbers;
    std::erase_if(texts, [&](const std::string& text) { return numbers->contains(text); });
    if (fit(texts)) return numbers;
    const auto longest = std::ranges::max_element(texts, {}, &std::string::size);
    if (longest->size() > texts_bytes_max)
        return fail(Exit::usage, "'" + longest->substr(0, shown_max) + "...' is a text of " +
                                     std::to_string(longest->size()) +
                                     " bytes, and those of one edit have at most " +
                                     std::to_string(texts_bytes_max) + " in all");
    return fail(
        Exit::usage,
        std::to_string(texts.size()) + " texts that use * or name a part within an instance, as '" +
            texts.front().substr(0, shown_max) + "', and one edit takes " +
            std::to_string(limits.list_items_max) + ", of " + std::to_string(texts_bytes_max) +
            " bytes in all: let * stand for several, or name parts by user ids, as uid=7");
}

/// True if an error quotes a path, or a step of it after the steps above.
bool quotes(const std::string& message, const std::string& path) {
    if (message.find("'" + path + "'") != std::string::npos) return true;
    for (std::size_t at = path.find('/'); at != std::string::npos; at = path.find('/', at + 1)) {
        const std::string step = path.substr(at + 1, path.find('/', at + 1) - at - 1);
        if (message.find("'" + path.substr(0, at) + "' has ") != std::string::npos &&
            message.find("'" + step + "'") != std::string::npos)
            return true;
    }
    return false;
}

/// Says of which change an error of the daemon is.
Failure located(Failure failure, const std::vector<EditChange>& changes) {
    if (is_own(failure)) return failure;
    constexpr std::string_view row = "row ", of = " of the edit ";
    std::size_t number = 0;
    const char* const end = failure.message.data() + failure.message.size();
    if (failure.message.starts_with(row)) {
        const auto [rest, error] =
            std::from_chars(failure.message.data() + row.size(), end, number);
        const std::string_view said(rest, static_cast<std::size_t>(end - rest));
        if (error == std::errc{} && number < changes.size() && said.starts_with(of))
            failure.message = changes[number].said + ": " + std::string(said.substr(of.size()));
        return failure;
    }
    const auto named = std::ranges::find_if(
        changes, [&](const EditChange& change) { return quotes(failure.message, change.path); });
    if (named != changes.end()) failure.message = named->said + ": " + failure.message;
    return failure;
}

}  // namespace

void declare(CommandLine& line, EditOptions& edit) {
    line.add_option("SCENE", edit.scene, "name of a loaded scene of yours").required();
    for (const Word& word : words)
        line.add_in_order(
            std::string("--").append(word.name),
            [&edit, &word](const std::string& text) {
                const std::string said = std::string("--").append(word.name) + " " + text;
                return read_change(word, text, said.substr(0, shown_max), edit);
            },
            word.text);
    line.add_in_order(
        "--file",
        [&edit](const std::string& path) {
            if (auto read = read_changes(path, edit); !read && !edit.bad_file)
                edit.bad_file = read.error();
            return std::string();
        },
        "File of changes, one a line, written like these options without dashes: move "
        "PATH=DX,DY,DZ. "
        "Empty lines, and those that begin with #, say nothing; all are one epoch. It has at "
        "most " +
            std::to_string(file_bytes_max >> 20) + " MiB and " +
            std::to_string(protocol::Limits{}.edit_rows_max) + " changes, and at most " +
            std::to_string(protocol::Limits{}.list_items_max) +
            " different texts that use * or name a part within an instance");
    line.add_flag("--keep", edit.keep,
                  "keep the edited scene through a restart, in a daemon with --state. Without this "
                  "option a restart brings back what was loaded or kept last");
    add_epoch(line, edit.epoch);
    line.at_end([&edit] {
        return edit.changes.empty() && !edit.bad_file
                   ? "--move, --turn, --place, --add, --remove, --set-mask, "
                     "--set-uid, --set-material, --hide, --show "
                     "or --file is required"
                   : std::string();
    });
}

namespace {

Result<void> send_changes(Context& context, const EditOptions& options) {
    wire::EditT request;
    request.scene = options.scene;
    request.epoch = options.epoch;
    request.keep = options.keep;
    const auto numbers = spare_texts(context, options, request.epoch);
    if (!numbers) return tl::unexpected<Failure>(numbers.error());
    TextList targets{request.targets}, scenes{request.scenes}, materials{request.materials};
    std::vector<EditRow> rows;
    for (const EditChange& change : options.changes) {
        EditRow row{static_cast<std::uint32_t>(change.what), 0, 0, change.value, {}};
        std::ranges::copy(change.matrix, std::begin(row.m));
        if (change.what == EditRow::set_material) row.value = materials.place_of(change.material);
        if (change.what == EditRow::add) {
            row.target = scenes.place_of(change.path);
        } else if (const auto instance = number_of(change.path, "inst=")) {
            row.target = *instance;
        } else if (const auto uid = number_of(change.path, "uid=")) {
            row.target = *uid;
            row.by = EditRow::uid;
        } else if (const auto known = numbers->find(change.path); known != numbers->end()) {
            row.target = known->second;
        } else {
            row.target = targets.place_of(change.path);
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

}  // namespace

Result<void> run(Context& context, const EditOptions& options) {
    if (options.bad_file) return tl::unexpected<Failure>(*options.bad_file);
    auto done = send_changes(context, options);
    if (!done) return tl::unexpected<Failure>(located(done.error(), options.changes));
    return done;
}

std::unique_ptr<Command> make_edit() {
    return make_command<EditOptions>();
}

}  // namespace raynest::client
