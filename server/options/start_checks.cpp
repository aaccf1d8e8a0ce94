#include "server/options/start_checks.h"

#include "engine/assets/sandbox/sandbox.h"
#include "engine/packs/load.h"
#include "engine/packs/registry.h"
#include "engine/system/module_file.h"
#include "server/ground/address.h"
#include "server/ground/log.h"
#include "server/options/option_words.h"
#include "server/security/certificates.h"
#include "server/security/credentials.h"
#include "server/security/file_place.h"
#include "server/security/user_namespace.h"

#include <grp.h>
#include <pwd.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>
#include <variant>

namespace raynest::server {
namespace {

/// Minimum number of file descriptors: the program's own files, a few clients, and the fourth that
/// is kept (descriptors.h).
constexpr rlim_t descriptors_min = 32;

bool listens_on_unix(const Options& options) {
    return std::ranges::any_of(options.listen,
                               [](const std::string& uri) { return uri.starts_with("unix:"); });
}

/// Finds the option whose file an error of Credentials begins with.
std::optional<OptionFault> security_fault(const SecurityOptions& security) {
    const auto loaded = Credentials(security).load();
    if (loaded) return std::nullopt;
    const std::string& why = loaded.error().message;
    const std::array<std::pair<const char*, std::string>, 4> files = {{
        {"tls-cert", security.tls.certificate},
        {"tls-key", security.tls.key},
        {"client-ca", security.tls.client_ca},
        {"tokens", security.tokens},
    }};
    for (const auto& [option, file] : files)
        if (!file.empty() && (why.starts_with(file + ':') || why.starts_with(file + ',')))
            return OptionFault{option, file, why};
    return OptionFault{"tls-cert", "", why};
}

/// Returns why this user cannot make files in a folder; empty if it can.
std::string folder_fault(const std::filesystem::path& folder) {
    std::error_code ignored;
    if (!std::filesystem::exists(folder, ignored))
        return "the folder " + folder.string() + " does not exist; make it";
    if (!std::filesystem::is_directory(folder, ignored))
        return folder.string() + " is not a folder";
    if (access(folder.c_str(), W_OK | X_OK) == 0) return "";
    return "this user cannot make files in " + folder.string() + ": " + std::strerror(errno);
}

std::optional<OptionFault> socket_fault(const std::string& uri) {
    const auto address = parse_address(uri);
    const auto* local = address ? std::get_if<UnixAddress>(&*address) : nullptr;
    if (local == nullptr || local->descriptor >= 0) return std::nullopt;
    std::error_code ignored;
    const auto path = std::filesystem::absolute(local->path, ignored);
    std::string why = folder_fault(path.parent_path());
    const auto status = std::filesystem::symlink_status(path, ignored);
    if (why.empty() && std::filesystem::exists(status) && !std::filesystem::is_socket(status))
        why = "something that is no socket is there; name another path";
    if (why.empty()) return std::nullopt;
    return OptionFault{"listen", uri, uri + ": " + why};
}

/// `place` is the folder, or the first on the way to it that is missing.
std::string state_access_fault(const std::filesystem::path& state,
                               const std::filesystem::path& place) {
    const std::string harm = "change the scenes";
    std::string why = place_fault(place, harm);
    for (const char* folder : {"blobs", "damaged"})
        if (why.empty()) why = others_fault(state / folder, harm);
    return why;
}

/// Returns why others could put code into the daemon; what belongs to the program itself is not asked.
std::optional<OptionFault> pack_access_fault(const Options& options) {
    const std::string harm = "run code in the daemon";
    for (const auto& folder : options.pack_dirs) {
        std::string why = place_fault(folder, harm);
        if (const auto packs = packs_in(folder); packs && why.empty())
            for (const auto& pack : *packs)
                if (why = place_fault(pack, harm); !why.empty()) break;
        if (!why.empty()) return OptionFault{"pack-dir", folder, std::move(why)};
    }
    if (options.cuda_pack.empty() || options.cuda_pack == to_cuda_pack("auto")) return std::nullopt;
    if (std::string why = place_fault(options.cuda_pack, harm); !why.empty())
        return OptionFault{"cuda", options.cuda_pack, std::move(why)};
    return std::nullopt;
}

std::optional<OptionFault> state_fault(const std::filesystem::path& state) {
    std::error_code ignored;
    auto folder = std::filesystem::absolute(state, ignored);
    auto place = folder;
    // The start makes the folders that are missing.
    while (!std::filesystem::exists(folder, ignored) && folder.has_relative_path()) {
        place = folder;
        folder = folder.parent_path();
    }
    std::string why = folder_fault(folder);
    if (why.empty()) why = state_access_fault(state, place);
    if (why.empty()) return std::nullopt;
    return OptionFault{"state", state, state.string() + ": " + why};
}

/// Fails for a module of the daemon's own that is cut short: those of shading and of pictures are
/// loaded with the first request that needs them, or in the import process.
Result<void> check_modules() {
    for (const char* folder : {"shading", "images"}) {
        const auto modules = packs_in(builtin_pack_directory() / folder);
        if (!modules) continue;
        for (const auto& module : *modules)
            if (const auto whole = check_module_file(module); !whole)
                return fail(ErrorCode::pack_invalid,
                            module.string() + ": " + whole.error().message);
    }
    return {};
}

Result<void> raise_descriptor_limit() {
    rlimit limit{};
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return {};
    limit.rlim_cur = limit.rlim_max;
    (void)setrlimit(RLIMIT_NOFILE, &limit);
    if (limit.rlim_max >= descriptors_min) return {};
    return fail(ErrorCode::io_failed,
                "it may open " + std::to_string(limit.rlim_max) + " files and needs at least " +
                    std::to_string(descriptors_min) + "; raise LimitNOFILE or ulimit -n for it");
}

}  // namespace

Result<StateLock> prepare_start(const Options& options) {
    if (const auto enough = raise_descriptor_limit(); !enough)
        return tl::unexpected(enough.error());
    if (const auto whole = check_modules(); !whole) return tl::unexpected(whole.error());
    // Check the ready file before anything listens: another program's file ends the start.
    if (!options.ready_file.empty())
        if (const auto free = check_ready_file(options.ready_file); !free)
            return tl::unexpected(free.error());
    if (const auto fault = pack_access_fault(options))
        return fail(ErrorCode::pack_invalid, "--" + fault->option + ": " + fault->why);
    if (options.state.empty()) return StateLock();
    auto lock = StateLock::take(options.state);
    if (const std::string why = state_access_fault(options.state, options.state); !why.empty())
        return fail(ErrorCode::io_failed, "--state: " + why);
    return lock || !options.takeover ? std::move(lock) : StateLock();
}

std::optional<OptionFault> start_fault(const Options& options) {
    if (auto fault = security_fault(options.security)) return fault;
    for (const std::string& uri : options.listen)
        if (auto fault = socket_fault(uri)) return fault;
    if (!options.state.empty())
        if (auto fault = state_fault(options.state)) return fault;
    if (!options.ready_file.empty())
        if (const auto free = check_ready_file(options.ready_file); !free)
            return OptionFault{"ready-file", options.ready_file, free.error().message};
    if (auto fault = pack_access_fault(options)) return fault;
    if (const auto registry = Registry::load({options.pack_dirs, options.target}); !registry)
        return OptionFault{options.pack_dirs.empty() ? "target" : "pack-dir", "",
                           registry.error().message};
    if (const auto whole = check_modules(); !whole)
        return OptionFault{"target", "", whole.error().message};
    return std::nullopt;
}

std::vector<StartWarning> start_warnings(const Options& options) {
    std::vector<StartWarning> found;
    if (listens_on_unix(options) && !tells_users_apart())
        found.push_back({"users_unknown",
                         "this user namespace does not map every user: those without a number of "
                         "their own need a token on the Unix socket"});
    for (const auto& folder : options.pack_dirs)
        if (const auto packs = packs_in(folder); packs && packs->empty())
            found.push_back({"pack_dir_empty",
                             "the folder of --pack-dir holds no .so file: " + folder.string()});
    if (!listens_on_unix(options) &&
        (options.socket.group || options.socket.mode != SocketAccess{}.mode))
        found.push_back(
            {"socket_access_unused", "--socket-mode and --socket-group need a --listen unix:PATH"});
    if (options.http.address == "off" &&
        !(options.http.hosts.empty() && options.http.proxies.empty()))
        found.push_back(
            {"http_unused", "--http-host and --trusted-proxy have no effect with --http off"});
    if (const std::string gaps = sandbox_gaps(); !gaps.empty())
        found.push_back(
            {"import_sandbox_weak",
             gaps + ": a file that takes over the import process can do more than it should"});
    if (options.scene_root.empty() && std::ranges::any_of(options.load, [](const auto& source) {
            return source.starts_with("root:");
        }))
        found.push_back({"load_without_root",
                         "--load names root:PATH, and there is no --scene-root "
                         "that has it; give one, or the path of the file"});
    struct stat state {};
    if (!options.state.empty() && stat(options.state.c_str(), &state) == 0 &&
        (state.st_mode & 055U) != 0)
        found.push_back({"state_folder_open", "other users can see the names of the files in " +
                                                  options.state.string() + "; chmod 700 " +
                                                  options.state.string()});
    const auto ca_key = options.security.tls.certificate.parent_path() / CertificateFiles::ca_key;
    if (geteuid() != 0 && ca_key.has_parent_path() && access(ca_key.c_str(), R_OK) == 0)
        found.push_back({"ca_key_exposed", "this user can read " + ca_key.string() +
                                               ", and so sign certificates; let "
                                               "root own it, mode 600: only tls renew needs it"});
    return found;
}

std::string become_service_user(const std::filesystem::path& config) {
    constexpr const char* folder = "/etc/raynest";
    constexpr const char* name = "raynest";
    std::error_code ignored;
    if (geteuid() != 0 || std::filesystem::absolute(config, ignored).parent_path() != folder)
        return "";
    const passwd* const user = getpwnam(name);  // NOLINT(concurrency-mt-unsafe): one thread
    if (user == nullptr || initgroups(name, user->pw_gid) != 0 || setgid(user->pw_gid) != 0 ||
        setuid(user->pw_uid) != 0)
        return "";
    return name;
}

}  // namespace raynest::server
