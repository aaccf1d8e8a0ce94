// The subcommands of `raynest`, one file each. A command takes a struct of options, sends requests,
// prints text or JSON and writes files. To add one: a row in commands.def, its struct here, and a
// file with declare(), which adds its options to the command line, and run().
#pragma once

#include "client/arguments/command_line.h"
#include "client/ground/failure.h"
#include "client/ground/progress.h"
#include "client/net/access.h"
#include "client/net/connection.h"
#include "client/output/fail_if.h"
#include "client/requests/film.h"
#include "client/requests/request_options.h"
#include "protocol/edit_row.h"

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace raynest::client {

struct LoadOptions {
    std::string source, name, build, primitive, instances, variant;
    WorldPoint origin{};
    bool auto_origin = false;
    std::string up;
    double unit = 0, radius = 0, spacing = 0;  ///< 0: not given
    std::vector<std::string> masks;            ///< "GLOB=HEX"
    std::vector<std::string> share;            ///< principals, or "public"
    bool replace = false;
};
struct ScenesOptions {};
struct InfoOptions {
    std::string scene;
    bool meshes = false;
    bool materials = false;
    MomentOptions moment;
};
struct PathOptions {
    std::string scene;
    std::string path;  ///< an id, or a text such as birch-17/leaves
    std::uint64_t epoch = 0;
};
struct AnimateOptions : RenderOptions {
    double fps = 25;
    double from = 0;  ///< seconds
    double to = -1;   ///< negative: the animation's end
};
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
struct ExportOptions {
    std::string scene, output;
    std::uint64_t epoch = 0;  ///< 0: the current one
    MomentOptions moment;
};
struct PinOptions {
    std::vector<std::string> scenes;
    bool off = false;
};
/// Selects scenes by name, all, or those that were not used for `idle_ms`.
struct UnloadOptions {
    std::vector<std::string> scenes;
    bool all = false;
    std::uint64_t idle_ms = 0;
};
struct VariantsOptions {};
struct StatsOptions {};
struct QueryOptions {
    JobOptions job;
    std::vector<WorldRay> rays;
    std::vector<std::string> generate;  ///< a kind and key=value (generator.h), or empty
    std::string step_error;             ///< for a sweep: a setting of its generator
    std::string rays_file, masks_file, kind, reduce, output;
    std::optional<WorldPoint> from;  ///< common origin of the file's rays
    std::uint32_t max_hits = 0;      ///< 0: the kind's default
    std::vector<std::string> fields;
    PartOption part;
    /// Arguments of raynest.returns.measure() (by_python.h), and their values as JSON
    std::vector<std::pair<std::string, std::string>> measure;
    std::string prefer;      ///< nearest | strongest
    std::string times_file;  ///< for rays that are sent
    double time_step = 0;    ///< seconds; 0: each ray has its own time
};
struct HeatmapOptions : PictureOptions {
    std::string metric, palette, scale, range, count;
    std::string range_from;                ///< an EXR whose range this map takes
    std::optional<Difference> difference;  ///< the other counts are subtracted
    std::vector<FailIf> fail_if;
    std::string command_line;  ///< for the report: the words of this command, as a shell takes them
    std::uint32_t top = 0;     ///< rows of a ranking; 0: none is asked for
    std::uint32_t level = 0;   ///< level of the instances that it groups by; 0: the innermost
};

struct ExplainOptions : LightOptions {
    JobOptions job;
    CameraOptions camera;
    std::optional<WorldRay> ray;  ///< else the pixel's
    std::optional<std::array<std::uint32_t, 2>> pixel;
    bool all = false;          ///< as many steps as the daemon tells
    std::uint32_t sample = 0;  ///< with an integrator: the one whose path is told
};

struct MergeOptions {
    std::string output;
    std::vector<std::string> parts;
    std::vector<std::string> limits;  ///< of --fail-if
};
struct TopOptions {
    bool once = false;  ///< one look, and the end
};
struct OpenOptions {
    std::string source;  ///< a scene's name, or a source that is loaded to stay; or empty
};
struct JobsOptions {};
struct WaitOptions {
    std::uint64_t job = 0;
    double deadline = 0;  ///< seconds; 0 = none
};
struct FetchOptions {
    std::uint64_t job = 0;
    std::string output;
    std::vector<std::string> generate;  ///< the words of the job's --generate
};
struct CancelOptions {
    std::uint64_t job = 0;
};
/// Keeps the token of a daemon, and copies of the certificates, in hosts.toml.
struct LoginOptions {
    std::string uri;
};
/// Removes what `login` kept.
struct LogoutOptions {
    std::string uri;  ///< empty: --server
};
/// A copy of all stored scenes, and the way back.
struct BackupOptions {
    std::string output;
};
struct RestoreOptions {
    std::string file;
    std::vector<std::string> scenes;  ///< OWNER/NAME; empty: all
};
struct GcOptions {};
struct AdminOptions {
    std::string act;     ///< connections | drain | reload | kick | quota
    std::string target;  ///< for kick: a connection's number or a principal; for quota: a principal
    std::vector<std::string> quota;  ///< "jobs=8"
};

template <class, class... Commands>
/// The first is no command: a list begins with commas
using VariantOf = std::variant<Commands...>;
/// The options of the command that was chosen.
using CommandOptions = VariantOf<void
#define RAYNEST_COMMAND(Name, ...) , Name##Options
#include "client/commands/commands.def"
                                 >;

struct Context {
    Connection& connection;
    Progress& progress;
    bool json = false;
    /// Opens another connection to the same daemon.
    std::function<Result<std::unique_ptr<Connection>>()> connect;
    const std::string& uri;
    const Access& access;
};

#define RAYNEST_COMMAND(Name, ...)                           \
    void declare(CommandLine& line, Name##Options& options); \
    Result<void> run(Context& context, const Name##Options& options);
#include "client/commands/commands.def"

/// `merge`, which needs no connection. The program becomes the one that joins them, or this fails.
Failure become_merge(const MergeOptions& options, bool json);

/// `logout` without a connection.
Result<void> log_out(const std::string& uri, bool json);

/// Asks for the token of `raynest login` on the terminal, without showing it, or reads it from
/// stdin.
Result<std::string> ask_token(const std::string& uri);

}  // namespace raynest::client
