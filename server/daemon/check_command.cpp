#include "server/daemon/check_command.h"

#include "protocol/text.h"
#include "server/options/ready_file.h"
#include "server/store/backup.h"
#include "server/store/manifest.h"
#include "server/store/state_folder.h"

#include <nlohmann/json.hpp>

#include <csignal>
#include <cstdint>
#include <iostream>
#include <new>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Most bytes of a printed line.
constexpr std::size_t line_bytes_max = 4096;

std::string clean(const std::string& text) {
    return protocol::clean_text(text, line_bytes_max);
}

/// Ends a command that has failed; the same error as `raynest --json` writes.
int failed(const std::string& why, Form form) {
    if (form == Form::json)
        std::cerr << nlohmann::json{{"error",
                                     {{"code", 1}, {"name", "FAILED"}, {"message", clean(why)}}}}
                  << '\n';
    else
        std::cerr << "raynestd: " << clean(why) << '\n';
    return 1;
}

/// The content of a state folder.
struct Findings {
    struct Damaged {
        std::string owner;
        std::string name;
        std::string why;
    };
    std::size_t scenes = 0;
    std::uint64_t bytes = 0;
    std::vector<Damaged> damaged;
    bool is_locked = true;      ///< no daemon could change it meanwhile
    std::string replaced = {};  ///< where a restore has put what was there; empty: nowhere
};

constexpr const char* manifest_name = "manifest.sqlite";

/// Returns the lock of a folder that a daemon has made, as `take` takes it.
Result<StateLock> lock_of(const std::filesystem::path& folder,
                          Result<StateLock> (*take)(const std::filesystem::path&)) {
    std::error_code error;
    if (std::filesystem::exists(folder / manifest_name, error) || is_half_restored(folder))
        return take(folder);
    return fail(ErrorCode::io_failed,
                error ? "cannot look into " + folder.string() + ": " + error.message()
                      : folder.string() + " is no state folder: it has no " + manifest_name);
}

/// Says what is wrong with a scene as it is stored; "" if nothing is.
std::string fault_of(const std::filesystem::path& folder, Manifest& manifest,
                     const StoredScene& row) {
    try {
        const auto stored = read_stored(folder, row.digest, row.bytes, row.content);
        if (!stored) return stored.error().why;
        const auto edits = manifest.edits(row.number);
        return edits ? gap_in(*edits, row.epoch) : edits.error().message;
    } catch (const std::bad_alloc&) {
        return "this machine has no memory for its " + protocol::bytes_text(row.bytes);
    }
}

Result<Findings> look(const std::filesystem::path& folder) {
    const auto lock = lock_of(folder, StateLock::take_to_read);
    if (!lock) return tl::unexpected(lock.error());
    if (is_half_restored(folder))
        return fail(ErrorCode::io_failed, "a restore of " + folder.string() +
                                              " was cut off; raynestd gc " + folder.string() +
                                              " finishes it, and so does a start");
    auto manifest = Manifest::open(folder / manifest_name, true);
    if (!manifest) return tl::unexpected(manifest.error());
    const auto rows = manifest->rows();
    if (!rows) return tl::unexpected(rows.error());
    Findings found;
    found.is_locked = lock->descriptor() >= 0;
    found.scenes = rows->size();
    for (const StoredScene& row : *rows) {
        found.bytes += row.bytes;
        if (auto why = fault_of(folder, *manifest, row); !why.empty())
            found.damaged.push_back({row.owner, row.name, std::move(why)});
    }
    return found;
}

int tell(const Result<Findings>& found, Form form) {
    if (!found) return failed(found.error().message, form);
    if (form == Form::json) {
        nlohmann::json damaged = nlohmann::json::array();
        for (const auto& scene : found->damaged)
            damaged.push_back({{"owner", clean(scene.owner)},
                               {"name", clean(scene.name)},
                               {"reason", clean(scene.why)}});
        nlohmann::json document = {
            {"scenes", found->scenes}, {"bytes", found->bytes}, {"damaged", damaged}};
        if (!found->is_locked) document["locked"] = false;
        if (!found->replaced.empty()) document["replaced"] = clean(found->replaced);
        std::cout << document << '\n';
    } else {
        for (const auto& scene : found->damaged)
            std::cout << clean(scene.owner + "/" + scene.name + ": " + scene.why +
                               "; load it again")
                      << '\n';
        std::cout << found->scenes << " scenes, " << protocol::bytes_text(found->bytes) << ", "
                  << found->damaged.size() << " damaged\n";
        if (!found->is_locked)
            std::cout << "it was not locked, because it cannot be written: what a daemon changed "
                         "meanwhile may be missing here\n";
        if (!found->replaced.empty())
            std::cout << "before it held what is now in " << clean(found->replaced)
                      << (found->damaged.empty() ? "" : ", where damaged scenes may be whole")
                      << "; once all is well, raynestd gc "
                      << clean(std::filesystem::path(found->replaced).parent_path().string())
                      << " removes that\n";
    }
    if (!std::cout.flush()) return failed("cannot write stdout", form);
    return found->damaged.empty() ? 0 : 1;
}

/// Exit code of a backup or restore that is done, but has damaged scenes; 1 says that nothing changed.
constexpr int done_with_damage = 3;

/// Tells what back_up() or restore() has made. `missing` is their outcome.
int tell_of_copy(const std::filesystem::path& from, const Result<std::uint64_t>& missing,
                 const std::filesystem::path& to, const std::string& replaced, Form form) {
    if (!missing) return failed(missing.error().message, form);
    auto found = look(to);
    if (found) found->replaced = replaced;
    const int code = tell(found, form);
    if (!found || found->damaged.empty()) return code;
    // Those without a blob are among the damaged ones, too.
    if (*missing != 0 && form == Form::text)
        (void)failed(std::to_string(*missing) + " scenes have lost their blobs in " +
                         from.string() + "; load them again",
                     form);
    return done_with_damage;
}

}  // namespace

int check_state(const std::filesystem::path& folder, Form form) {
    return tell(look(folder), form);
}

int back_up_state(const std::filesystem::path& from, const std::filesystem::path& to, Form form) {
    (void)std::signal(SIGXFSZ, SIG_IGN);  // write() says EFBIG
    return tell_of_copy(from, back_up(from, to), to, "", form);
}

int restore_state(const std::filesystem::path& backup, const std::filesystem::path& folder,
                  Form form) {
    (void)std::signal(SIGXFSZ, SIG_IGN);
    Result<std::uint64_t> missing;
    {
        const auto lock = StateLock::take(folder);
        if (!lock) return failed(lock.error().message, form);
        missing = restore(backup, folder);
    }
    std::error_code error;
    const bool has_replaced = std::filesystem::exists(folder / "replaced", error);
    return tell_of_copy(backup, missing, folder, has_replaced ? (folder / "replaced").string() : "",
                        form);
}

int remove_state_garbage(const std::filesystem::path& folder, Form form) {
    const auto lock = lock_of(folder, StateLock::take);
    if (!lock) return failed(lock.error().message, form);
    const auto bytes = remove_garbage(folder);
    if (!bytes) return failed(bytes.error().message, form);
    if (form == Form::json)
        std::cout << nlohmann::json{{"removed_bytes", *bytes}} << '\n';
    else
        std::cout << protocol::bytes_text(*bytes) << " removed\n";
    return std::cout.flush() ? 0 : failed("cannot write stdout", form);
}

}  // namespace raynest::server
