#include "server/options/reload.h"

#include "server/ground/log.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

namespace raynest::server {
namespace {

/// Limits that threads read while they compute, or that were copied at the start.
constexpr std::array<std::string_view, 6> lasting_limits = {
    "chunk_ms_max",      "cuda_rays_max", "cuda_call_ms_max",
    "cuda_start_ms_max", "cuda_retry_ms", "cuda_retry_ms_max"};

std::string option_of(std::string_view limit) {
    std::string name(limit);
    std::ranges::replace(name, '_', '-');
    return name;
}

void add(std::string& names, const char* name) {
    if (!names.empty()) names += ',';
    names += name;
}

/// True if `now` lacks one of `before`.
bool lacks_one(const std::vector<std::string>& now, const std::vector<std::string>& before) {
    return !std::ranges::all_of(before,
                                [&](const auto& one) { return std::ranges::count(now, one) != 0; });
}

/// Says whether options of security that have changed are taken, wait for a restart, or stay
/// because one of their files is unusable.
enum class SecurityChange { take, at_restart, unusable };

/// Takes all values but those that only a restart applies, which it names.
void apply_changes(Options& now, const Options& then, SecurityChange security, Reload& reload) {
    const auto take = [&](const char* name, auto& value, const auto& wanted) {
        if (value == wanted) return;
        value = wanted;
        add(reload.changed, name);
    };
    const auto keep = [&](const char* name, const auto& value, const auto& wanted) {
        if (!(value == wanted)) add(reload.needs_restart, name);
    };
    const auto secure = [&](const char* name, auto& value, const auto& wanted) {
        if (security == SecurityChange::take) take(name, value, wanted);
        if (security == SecurityChange::at_restart) keep(name, value, wanted);
    };
    take("log-level", now.log_level, then.log_level);
    take("log-format", now.log_format, then.log_format);
    take("http-host", now.http.hosts, then.http.hosts);
    // Less trust is taken at once; more waits for a restart.
    if (!lacks_one(now.http.proxies, then.http.proxies))
        take("trusted-proxy", now.http.proxies, then.http.proxies);
    secure("tls-cert", now.security.tls.certificate, then.security.tls.certificate);
    secure("tls-key", now.security.tls.key, then.security.tls.key);
    secure("client-ca", now.security.tls.client_ca, then.security.tls.client_ca);
    secure("tokens", now.security.tokens, then.security.tokens);
    secure("anonymous", now.security.anonymous, then.security.anonymous);
    keep("insecure", now.security.insecure, then.security.insecure);
    keep("listen", now.listen, then.listen);
    keep("http", now.http.address, then.http.address);
    keep("trusted-proxy", now.http.proxies, then.http.proxies);
    keep("socket-mode", now.socket.mode, then.socket.mode);
    keep("socket-group", now.socket.group, then.socket.group);
    keep("state", now.state, then.state);
    keep("scene-root", now.scene_root, then.scene_root);
    keep("load", now.load, then.load);
    keep("pack-dir", now.pack_dirs, then.pack_dirs);
    keep("threads", now.threads, then.threads);
    keep("memory", now.memory, then.memory);
    keep("target", now.target, then.target);
    keep("cuda", now.cuda_pack, then.cuda_pack);
    keep("ready-file", now.ready_file, then.ready_file);
    for (const protocol::LimitInfo& limit : protocol::limit_table()) {
        const std::string name = option_of(limit.name);
        if (std::ranges::count(lasting_limits, limit.name) != 0)
            keep(name.c_str(), now.limits.*limit.value, then.limits.*limit.value);
        else
            take(name.c_str(), now.limits.*limit.value, then.limits.*limit.value);
    }
}

}  // namespace

ReadAgain read_again(const std::function<Result<Options>()>& read, const SecurityOptions& now) {
    Result<Options> then = read();
    SecurityOptions wanted = then ? then->security : now;
    wanted.insecure = now.insecure;
    ReadAgain all{std::move(then), Credentials::read(wanted), {}};
    if (wanted != now) all.kept = Credentials::read(now);
    return all;
}

Reload reload_options(Options& now, ReadAgain read, Credentials& credentials,
                      const std::vector<ListenAddress>& open) {
    Reload reload;
    const Result<Options>& then = read.then;
    SecurityOptions wanted = now.security;
    if (then) {
        wanted = then->security;
        wanted.insecure = now.security.insecure;
        reload.weaker = weakened(open, now.security, wanted, now.socket);
    } else {
        reload.fault = then.error().message;
        log(LogLevel::error, "configuration_unusable", {{"reason", reload.fault}, {"kept", "old"}});
    }
    const bool stays = !reload.weaker.empty();
    const auto take = [&](const SecurityOptions& options) -> Result<void> {
        if (options == read.wanted.options()) return credentials.take(std::move(read.wanted));
        if (read.kept && options == read.kept->options())
            return credentials.take(std::move(*read.kept));
        return {};  // another reload has changed the options meanwhile, and read their files
    };
    if (const auto taken = take(stays ? now.security : wanted); !taken) {
        if (reload.fault.empty()) reload.fault = taken.error().message;
        if (!stays && wanted != now.security) (void)take(now.security);
    }
    if (!then) return reload;
    const bool taken = credentials.options() == wanted;
    const bool is_new = !stays && taken && wanted != now.security;
    const HttpOptions site = now.http;
    apply_changes(now, *then,
                  stays   ? SecurityChange::at_restart
                  : taken ? SecurityChange::take
                          : SecurityChange::unusable,
                  reload);
    reload.is_site_smaller =
        lacks_one(now.http.hosts, site.hosts) || lacks_one(now.http.proxies, site.proxies);
    if (!reload.needs_restart.empty())
        log(LogLevel::warn, "restart_needed",
            {{"options", reload.needs_restart}, {"reason", reload.weaker}});
    if (is_new) log_openness(open, now);
    return reload;
}

Reply<std::string> told(const Reload& done) {
    const bool good = done.fault.empty();
    const std::string read = "configuration, certificates and tokens were read again";
    log(good ? LogLevel::info : LogLevel::error, "reloaded",
        {{"result", good ? read : "some files were unusable and their old content stays"},
         {"changed", done.changed}});
    if (!good)
        return refuse(Code::file_unusable, without_folders(done.fault) + "; the old content stays");
    if (done.needs_restart.empty()) return read;
    return read + "; these options wait for a restart: " + done.needs_restart;
}

void take_limits(protocol::Limits& now, const protocol::Limits& then) {
    for (const protocol::LimitInfo& limit : protocol::limit_table())
        if (auto& value = now.*limit.value; value != then.*limit.value) value = then.*limit.value;
}

void log_openness(const std::vector<ListenAddress>& open, const Options& options) {
    for (const ListenAddress& at : open)
        log(LogLevel::info, "open",
            {{"uri", to_uri(at.address)},
             {"to", to_text(openness(at, options.security, options.socket))}});
}

}  // namespace raynest::server
