#include "client/requests/generator.h"

#include "client/files/files.h"
#include "client/files/npy.h"
#include "client/ground/numbers.h"
#include "client/ground/text.h"
#include "protocol/limits.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <set>
#include <string_view>
#include <utility>

namespace raynest::client {
namespace {

struct Row {
    std::string_view name, text;  ///< text: a kind's keys, or the description of a key
};
constexpr std::array kinds = {
#define RAYNEST_GENERATOR(name, settings, t, rays) Row{#name, settings},
#include "protocol/lists/generators.def"
};
constexpr std::array keys = {
#define RAYNEST_SETTING(name, type, text) Row{#name, text},
#include "protocol/lists/generators.def"
};

/// True for kinds with the setting `pose`, which is the identity by default.
bool has_pose(std::string_view kind) {
    return std::any_of(kinds.begin(), kinds.end(), [&](const Row& row) {
        return row.name == kind &&
               (", " + std::string(row.text) + ",").find(", pose,") != std::string::npos;
    });
}

/// Returns "name=1,2.5" with all digits.
std::string setting(const std::string& name, const std::vector<double>& numbers) {
    std::string text = name;
    for (const double number : numbers) {
        std::array<char, 32> digits{};
        const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), number);
        text += (text == name ? '=' : ',') + std::string(digits.data(), end.ptr);
    }
    return text;
}

/// A setting that announces numbers which follow in frames: the daemon waits for them.
struct CountOfSent {
    std::string_view key;
    std::string_view instead;
};
constexpr std::array counts_of_sent = {CountOfSent{"poses", "trajectory=FILE.npy"},
                                       CountOfSent{"channels", "elevations=FILE.npy"},
                                       CountOfSent{"columns", "azimuths=FILE.npy"}};

/// True for sensors in motion, whose rays have times.
bool moves(const wire::GeneratorT& generator) {
    return generator.kind == "sweep" || generator.kind == "rolling_shutter";
}

Result<void> take(Generate& to, const std::string& key, const std::string& value) {
    const auto read = [&](std::vector<double>& numbers, std::size_t few, std::size_t many,
                          const char* shape) -> Result<void> {
        auto parsed = parse_world(value, few, many, shape);
        if (!parsed) return fail(Exit::usage, key + ": " + parsed.error().message);
        numbers = std::move(*parsed);
        return {};
    };
    if (key == "pose") return read(to.pose, 12, 12, "12 numbers, the rows of a 3x4 matrix");
    if (key == "lookat") return read(to.look_at, 6, 9, "ex,ey,ez,ax,ay,az[,ux,uy,uz]");
    if (key == "points") {
        to.points = value;
        to.message.settings.push_back("points=");  // the client reads the file and sends its points
        return {};
    }
    if (key == "trajectory") {
        to.trajectory = value;
        return {};
    }
    if (value.ends_with(".npy") && (key == "elevations" || key == "azimuths")) {
        if (to.message.kind != "sweep")
            return fail(Exit::usage,
                        key +
                            ": angles from a file are those of --generate sweep; a trajectory of "
                            "one row stands still, with begin=0 and end=0");
        (key == "elevations" ? to.elevations : to.azimuths) = value;
        return {};
    }
    if (key == "azimuths" && to.message.kind == "sweep" && value.find(':') == std::string::npos)
        return fail(Exit::usage, "azimuths: '" + value +
                                     "' is not START:STOP:COUNT; angles in any order are a file: "
                                     "azimuths=FILE.npy");
    const auto counts = std::ranges::find(counts_of_sent, key, &CountOfSent::key);
    if (counts != counts_of_sent.end())
        return fail(Exit::usage, key + " counts what a program sends; on the command line it is " +
                                     std::string(counts->instead));
    to.message.settings.push_back(key + "=" + value);
    return {};
}

}  // namespace

std::optional<WorldPoint> Generate::start() const {
    if (!pose.empty()) return WorldPoint{pose[3], pose[7], pose[11]};
    if (!look_at.empty()) return WorldPoint{look_at[0], look_at[1], look_at[2]};
    return std::nullopt;
}

wire::GeneratorT Generate::at(const WorldPoint& origin) const {
    wire::GeneratorT placed = message;
    std::vector<double> matrix = pose;
    const bool elsewhere =
        !look_at.empty() ||
        std::any_of(placed.settings.begin(), placed.settings.end(),
                    [](const std::string& each) { return each.starts_with("camera="); });
    // Without a pose the sensor is at the origin of the world.
    if (matrix.empty() && !elsewhere && has_pose(placed.kind) && origin != WorldPoint{})
        matrix = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    for (std::size_t row = 0; row < matrix.size() / 4; ++row) matrix[4 * row + 3] -= origin[row];
    std::vector<double> eye_at_up = look_at;
    for (std::size_t i = 0; i < std::min<std::size_t>(eye_at_up.size(), 6); ++i)
        eye_at_up[i] -= origin[i % 3];
    if (!matrix.empty()) placed.settings.push_back(setting("pose", matrix));
    if (!eye_at_up.empty()) placed.settings.push_back(setting("lookat", eye_at_up));
    return placed;
}

Result<Generate> parse_generate(std::span<const std::string> words) {
    if (words.empty()) return fail(Exit::usage, "--generate needs a kind");
    Generate generate;
    generate.message.kind = words.front();
    std::set<std::string> keys;
    for (const std::string& word : words.subspan(1)) {
        const std::size_t equals = word.find('=');
        if (equals == std::string::npos)
            return fail(Exit::usage, "'" + word + "' is not key=value");
        const std::string key = word.substr(0, equals);
        if (!keys.insert(key).second) return fail(Exit::usage, key + " is given twice");
        if (auto taken = take(generate, key, word.substr(equals + 1)); !taken)
            return tl::unexpected<Failure>(taken.error());
    }
    if (moves(generate.message) && generate.trajectory.empty())
        return fail(Exit::usage, "generator " + generate.message.kind +
                                     " needs trajectory=FILE.npy: rows of a time and a pose");
    return generate;
}

namespace {

std::string setting_of(const wire::GeneratorT& generator, std::string_view name) {
    for (const std::string& each : generator.settings)
        if (each.starts_with(name) && each.size() > name.size() && each[name.size()] == '=')
            return each.substr(name.size() + 1);
    return {};
}

/// The whole number at the end of a text, at most 2^32; 0: there is none.
std::uint64_t number_at_end(std::string_view text) {
    const std::size_t before = text.find_last_not_of("0123456789");
    if (before != std::string_view::npos) text.remove_prefix(before + 1);
    std::uint32_t number = 0;
    std::from_chars(text.data(), text.data() + text.size(), number);
    return number;
}

/// True for those whose rows are channels, of which the daemon makes no tiles that matter.
bool has_channels(const wire::GeneratorT& generator) {
    return generator.kind == "lidar" || generator.kind == "sweep";
}

struct Grid {
    std::uint64_t width = 0, height = 0;
};
Grid grid_of(const wire::GeneratorT& generator) {
    if (has_channels(generator)) {
        const std::string elevations = setting_of(generator, "elevations");
        const std::string azimuths = setting_of(generator, "azimuths");
        const bool steps = elevations.find(':') != std::string::npos;
        const std::uint64_t channels =
            elevations.empty() ? number_at_end(setting_of(generator, "channels"))
            : steps            ? number_at_end(elevations)
                    : 1 + static_cast<std::uint64_t>(std::ranges::count(elevations, ','));
        const std::string scans = setting_of(generator, "scans");
        return {number_at_end(azimuths.empty() ? setting_of(generator, "columns") : azimuths),
                scans.empty() ? channels : channels * number_at_end(scans)};
    }
    const std::string size = setting_of(generator, "size");
    if (size.empty()) return {960, 540};
    return {number_at_end(size.substr(0, size.find('x'))), number_at_end(size)};
}

}  // namespace

std::vector<std::string> SensorColumns::of(const wire::GeneratorT& generator) {
    std::vector<std::string> names;
    if (has_channels(generator)) names.emplace_back("ring");
    if (moves(generator)) names.emplace_back("time");
    return names;
}

Result<SensorColumns> SensorColumns::take(std::vector<std::string>& fields,
                                          const wire::GeneratorT* generator) {
    SensorColumns made;
    for (const char* name : {"ring", "time"}) {
        if (std::ranges::find(fields, name) == fields.end()) continue;
        const std::vector<std::string> known =
            generator == nullptr ? std::vector<std::string>() : of(*generator);
        if (std::ranges::find(known, name) == known.end())
            return fail(Exit::usage,
                        std::string("the column ") + name + " is of --generate " +
                            (name == std::string_view("ring") ? "lidar and sweep"
                                                              : "sweep and rolling_shutter"));
        std::erase(fields, name);
        made.names_.emplace_back(name);
    }
    if (made.empty()) return made;
    const Grid grid = grid_of(*generator);
    const std::string scans = setting_of(*generator, "scans");
    const std::uint64_t count = scans.empty() ? 1 : number_at_end(scans);
    made.columns_ = std::max<std::uint64_t>(1, grid.width);
    made.channels_ = std::max<std::uint64_t>(1, grid.height / std::max<std::uint64_t>(1, count));
    const auto time = [&](const char* name, double otherwise) -> Result<double> {
        const std::string text = setting_of(*generator, name);
        if (text.empty()) return otherwise;
        const auto parsed = parse_world(text, 1, 1, "a number");
        if (!parsed) return fail(Exit::usage, std::string(name) + ": " + parsed.error().message);
        return parsed->front();
    };
    const auto begin = time("begin", 0), end = time("end", 0.1);
    if (!begin) return tl::unexpected<Failure>(begin.error());
    if (!end) return tl::unexpected<Failure>(end.error());
    made.begin_ = *begin, made.end_ = *end;
    made.by_rows_ = !has_channels(*generator);
    made.lines_ = made.by_rows_ ? made.channels_ : made.columns_;
    return made;
}

Result<void> SensorColumns::beside(
    std::span<const protocol::BlockView> columns, std::uint64_t first, std::uint64_t count,
    const std::function<Result<void>(std::span<const protocol::BlockView>)>& use) const {
    std::vector<protocol::BlockView> all(columns.begin(), columns.end());
    std::vector<std::vector<std::uint64_t>> values;
    for (const std::string& name : names_) {
        std::vector<std::uint64_t>& made = values.emplace_back();
        made.reserve(count);
        for (std::uint64_t ray = first; ray < first + count; ++ray) {
            const std::uint64_t row = ray / columns_;
            const std::uint64_t line = by_rows_ ? row : row / channels_ * columns_ + ray % columns_;
            const double time =
                begin_ + (end_ - begin_) * static_cast<double>(line) / static_cast<double>(lines_);
            made.push_back(name == "ring" ? row % channels_ : std::bit_cast<std::uint64_t>(time));
        }
        all.push_back(
            {name, wire::Dtype::u64, sizeof(std::uint64_t), count, std::as_bytes(std::span(made))});
    }
    return use(all);
}

bool is_time(const protocol::BlockView& block) {
    return block.name == "time" && block.dtype == wire::Dtype::u64;
}

bool is_ring(const protocol::BlockView& block) {
    return block.name == "ring" && block.dtype == wire::Dtype::u64;
}

std::uint64_t sensor_rays(const wire::GeneratorT& generator) {
    const Grid grid = grid_of(generator);
    return grid.width * grid.height;
}

std::uint64_t sensor_band(const wire::GeneratorT& generator) {
    constexpr std::uint64_t tile_rows = 8;
    return has_channels(generator)
               ? 1
               : std::max<std::uint64_t>(1, tile_rows * grid_of(generator).width);
}

namespace {

/// Appends the numbers of an array of shape (N, `width`), or (N,) where that is 1, and returns N, at
/// most `most`. `what` is what a row holds.
Result<std::uint64_t> append_rows(const std::string& path, std::uint64_t width, std::uint64_t most,
                                  const std::string& what, std::vector<double>& values) {
    constexpr std::uint64_t header_bytes_max = 128ULL << 10;
    const auto blame = [&](const std::string& why) {
        return fail(Exit::invalid, shown_name(path) + " " + why);
    };
    auto file = read_file(path, most * width * sizeof(double) + header_bytes_max);
    if (!file) return tl::unexpected<Failure>(file.error());
    auto array = parse_npy(std::as_const(*file).span());
    if (!array) return blame(array.error().message);
    std::vector<std::uint64_t>& shape = array->shape;
    if (shape.empty() || shape.size() != (width == 1 ? 1 : 2) || shape[0] == 0 || shape[0] > most ||
        (width != 1 && shape[1] != width))
        return blame("must have the shape (N" + (width == 1 ? "," : ", " + std::to_string(width)) +
                     "), of 1 to " + std::to_string(most) + " rows: " + what);
    shape.resize(2, 1);
    for (std::uint64_t row = 0; row < shape[0]; ++row)
        for (std::uint64_t i = 0; i < width; ++i) values.push_back(value_at(*array, row, i));
    return shape[0];
}

}  // namespace

Result<std::vector<std::byte>> read_sent_numbers(const Generate& generate, const WorldPoint& origin,
                                                 wire::GeneratorT& to) {
    constexpr std::uint64_t numbers = 13;
    const protocol::Limits limits;
    std::vector<double> values;
    const auto append = [&](const std::string& path, const char* setting, std::uint64_t width,
                            std::uint64_t most, const std::string& what) -> Result<void> {
        if (path.empty()) return {};
        const auto count = append_rows(path, width, most, what, values);
        if (!count) return tl::unexpected<Failure>(count.error());
        to.settings.push_back(std::string(setting) + "=" + std::to_string(*count));
        return {};
    };
    if (auto done = append(generate.trajectory, "poses", numbers, limits.trajectory_poses_max,
                           "a time, and a 3x4 matrix row by row");
        !done)
        return tl::unexpected<Failure>(done.error());
    for (std::size_t row = 0; row < values.size(); row += numbers)
        for (std::size_t axis = 0; axis < 3; ++axis) values[row + 4 * (axis + 1)] -= origin[axis];
    // In the order in which the daemon reads them.
    if (auto done =
            append(generate.elevations, "channels", 1, limits.sweep_channels_max, "degrees");
        !done)
        return tl::unexpected<Failure>(done.error());
    if (auto done = append(generate.azimuths, "columns", 1, limits.azimuths_max, "degrees"); !done)
        return tl::unexpected<Failure>(done.error());
    const auto bytes = std::as_bytes(std::span(values));
    return std::vector<std::byte>(bytes.begin(), bytes.end());
}

std::string generate_help() {
    std::string help = "\nKinds of --generate and their keys:\n";
    const auto add = [&](const Row& row) {
        help += "  " + std::string(row.name) + std::string(18 - row.name.size(), ' ') +
                std::string(row.text) + "\n";
    };
    std::for_each(kinds.begin(), kinds.end(), add);
    help += "\n";
    std::for_each(keys.begin(), keys.end(), add);
    return help;
}

}  // namespace raynest::client
