// raynest open [SCENE]: shows the daemon's page in the browser, or tells its address.
#include "client/commands/command.h"
#include "client/ground/child_process.h"
#include "client/ground/interrupt.h"
#include "client/ground/json.h"
#include "client/net/address.h"
#include "client/output/output.h"
#include "client/requests/scene_source.h"

#include <sys/wait.h>

#include <chrono>
#include <cstdlib>
#include <iostream>
#include <string_view>
#include <thread>

namespace raynest::client {
namespace {

struct OpenOptions {
    std::string source;  ///< a scene's name, or a source that is loaded to stay; or empty
};

using Clock = std::chrono::steady_clock;

/// A program that runs for longer has shown the page.
constexpr std::chrono::seconds browser_time{5};

/// Returns text as it stands in the fragment of an address.
std::string percent_encoded(std::string_view text) {
    constexpr std::string_view plain =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_.~";
    constexpr std::string_view digits = "0123456789ABCDEF";
    std::string encoded;
    for (const char c : text) {
        const auto byte = static_cast<unsigned char>(c);
        if (plain.find(c) != std::string_view::npos)
            encoded += c;
        else
            encoded.append({'%', digits[byte >> 4], digits[byte & 15]});
    }
    return encoded;
}

/// Returns HOST:PORT of http://HOST:PORT or https://HOST:PORT; empty if it is neither. A browser and
/// the user's shell get it.
std::string host_of(std::string_view address) {
    for (const std::string_view scheme : {"http://", "https://"}) {
        if (!address.starts_with(scheme)) continue;
        const std::string place(address.substr(scheme.size()));
        return authority_of("tcp://" + place) ? place : "";
    }
    return "";
}

/// Replaces the host of a page that listens on every address by the host of the daemon's URI.
std::string reachable(const std::string& address, const std::string& server) {
    for (const std::string_view any : {"//0.0.0.0:", "//[::]:"}) {
        const std::size_t at = address.find(any);
        if (at == std::string::npos) continue;
        const std::size_t begin = server.find("://");
        const bool has_host = server.starts_with("tcp://") || server.starts_with("tls://");
        const std::string host =
            has_host ? server.substr(begin + 3, server.rfind(':') - begin - 3) : "127.0.0.1";
        return address.substr(0, at + 2) + host + address.substr(at + any.size() - 1);
    }
    return address;
}

bool has_display() {
    for (const char* name : {"DISPLAY", "WAYLAND_DISPLAY"})
        if (const char* value = std::getenv(name); value != nullptr && *value != '\0') return true;
    return false;
}

/// Runs xdg-open, which returns once a browser has the address, or is the browser and goes on;
/// false where there is none.
bool show(const std::string& address) {
    auto program = ChildProcess::start({"xdg-open", address}, ChildKind::independent);
    if (!program) return false;
    const Clock::time_point end = Clock::now() + browser_time;
    int status = 0;
    while (!program->has_ended(&status)) {
        if (interrupted() || Clock::now() > end) return true;
        std::this_thread::sleep_for(look_time);
    }
    return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

/// Loads the source that stands in the place of a scene, as `raynest load` does; the name stays.
Result<std::string> load_to_stay(Context& context, const std::string& source) {
    const Result<Upload> upload = gather(source, "", "");
    if (!upload) return tl::unexpected<Failure>(upload.error());
    wire::LoadT load;
    load.name = upload->scene_name;
    const auto loaded = load_scene(context.connection, context.progress, load, *upload);
    context.progress.clear();
    if (!loaded) return tl::unexpected<Failure>(loaded.error());
    return std::string(protocol::text(protocol::present((*loaded)->info()).name()));
}

}  // namespace

void declare(CommandLine& line, OpenOptions& open) {
    line.add_option("SCENE", open.source,
                    "name of a loaded scene (the first one); or FILE.glb, builtin:NAME and so on, "
                    "which is loaded as by raynest load");
}

Result<void> run(Context& context, const OpenOptions& options) {
    std::string scene = options.source;
    if (is_source(scene)) {
        auto name = load_to_stay(context, scene);
        if (!name) return tl::unexpected<Failure>(name.error());
        scene = std::move(*name);
    }
    if (!scene.empty()) {
        wire::InfoT info;
        info.scene = scene;
        const auto known = ask<wire::SceneInfo>(context.connection, info);
        if (!known) return tl::unexpected<Failure>(known.error());
    }
    // Last, because the code of the address is valid for a short time.
    const auto reply = ask<wire::PageAddress>(context.connection, wire::PageT{});
    if (!reply) return tl::unexpected<Failure>(reply.error());
    std::string address(protocol::text((*reply)->http()));
    if (address.empty())
        return fail(Exit::failed,
                    "this daemon serves no page: start raynestd with --http 127.0.0.1:31061");
    const std::string place = host_of(address);
    if (place.empty())
        return fail(Exit::failed, "the daemon names '" + address + "', which is no http address");
    address = reachable(address, context.uri);
    address += "/#";
    if (!scene.empty()) address += "scene=" + percent_encoded(scene) + "&";
    address += "code=" + percent_encoded(protocol::text((*reply)->code()));
    const bool opened = has_display() && show(address);
    if (context.json) {
        print_json(Json{{"address", address}, {"opened", opened}});
        return {};
    }
    std::cout << address << '\n';
    if (!opened)
        std::cerr << "raynest: open this address in a browser, once and within "
                  << (*reply)->code_ms() / 1000 << " s";
    if (!opened && address.find("://127.") != std::string::npos)
        std::cerr << "; on another machine run ssh -L " << place.substr(place.rfind(':') + 1) << ':'
                  << place << " HOST there first";
    if (!opened) std::cerr << '\n';
    return {};
}

namespace {

class Open final : public CommandOf<OpenOptions> {
    [[nodiscard]] bool needs_lasting_daemon() const override { return true; }
};

}  // namespace

std::unique_ptr<Command> make_open() {
    return std::make_unique<Open>();
}

}  // namespace raynest::client
