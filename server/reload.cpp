#include "server/options.h"

#include <algorithm>
#include <array>
#include <string_view>

namespace raynest::server {
namespace {

/// Limits that threads read while they compute, or that were copied at the start.
constexpr std::array<std::string_view, 6> lasting_limits = {
    "chunk_ms_max", "cuda_rays_max", "cuda_call_ms_max",
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

}  // namespace

Reload apply_changes(Options& now, const Options& then) {
    Reload reload;
    const auto take = [&](const char* name, auto& value, const auto& wanted) {
        if (value == wanted) return;
        value = wanted;
        add(reload.changed, name);
    };
    take("log-level", now.log_level, then.log_level);
    take("log-format", now.log_format, then.log_format);
    take("http-host", now.http.hosts, then.http.hosts);
    take("tls-cert", now.security.tls.certificate, then.security.tls.certificate);
    take("tls-key", now.security.tls.key, then.security.tls.key);
    take("client-ca", now.security.tls.client_ca, then.security.tls.client_ca);
    take("tokens", now.security.tokens, then.security.tokens);
    take("anonymous", now.security.anonymous, then.security.anonymous);

    const auto keep = [&](const char* name, const auto& value, const auto& wanted) {
        if (!(value == wanted)) add(reload.needs_restart, name);
    };
    keep("listen", now.listen, then.listen);
    keep("http", now.http.address, then.http.address);
    keep("socket-mode", now.socket.mode, then.socket.mode);
    keep("socket-group", now.socket.group, then.socket.group);
    keep("insecure", now.security.insecure, then.security.insecure);
    keep("state", now.state, then.state);
    keep("scene-root", now.scene_root, then.scene_root);
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
    return reload;
}

}  // namespace raynest::server
