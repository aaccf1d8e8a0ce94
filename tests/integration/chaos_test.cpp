// Simulates a bad network at every point of a conversation. Whatever happens to one client, the
// daemon releases that client's resources and serves the others; if all bytes arrive, the answers
// are the same.
//
// RAYNEST_CHAOS_SEEDS sets the number of seeds per point.
#include "protocol/edit_row.h"
#include "protocol/hash.h"
#include "tests/integration/chaos_proxy.h"
#include "tests/integration/daemon.h"

#include <doctest/doctest.h>

#include <array>
#include <cstdlib>
#include <cstring>
#include <map>
#include <optional>
#include <span>
#include <sstream>

namespace raynest::test {
namespace {

using wire::Message;

/// The frames that a client received in one conversation; nothing if it was cut short.
using Learnt = std::optional<std::map<std::string, std::uint64_t>>;

/// Sends requests through the given network and records the answers, up to the stream's end.
class Client {
public:
    explicit Client(std::uint16_t port) : peer_(port) {}

    template <class Native>
    Client& say(std::uint64_t id, const Native& message) {
        return send(protocol::encode(id, message).value());
    }
    Client& send(const protocol::Frame& frame) {
        alive_ = alive_ && peer_.send_frame(frame);
        return *this;
    }
    /// Reads frames up to one of this type.
    Client& until(Message last) {
        while (alive_) {
            const auto frame = peer_.read();
            alive_ = frame.has_value();
            if (!alive_) break;
            const auto type = static_cast<Message>(frame->header.type);
            const std::string name = protocol::message_name(frame->header.type) + " of " +
                                     std::to_string(frame->header.request_id);
            // Chunks come in any order.
            if (type != Message::Progress)
                learnt_[name] += 1 + protocol::upload_checksum(frame->bulk.span());
            if (type == last) break;
        }
        return *this;
    }
    Learnt learnt() const { return alive_ ? Learnt(learnt_) : std::nullopt; }

private:
    Peer peer_;
    bool alive_ = true;
    std::map<std::string, std::uint64_t> learnt_;
};

/// Traces: every message of a query and a picture, a cancelled job, a ping.
Learnt trace(std::uint16_t port) {
    constexpr std::uint64_t chunk = 100;
    wire::CreditT credit;
    credit.bytes = 1 << 16;
    wire::RenderT render;
    render.job = std::make_unique<wire::JobT>();
    render.job->scene = "scene";
    render.width = render.height = 24;
    render.encode = "raw";
    Client client(port);
    return client.say(0, wire::HelloT{})
        .until(Message::Welcome)
        .say(5, query_of(2 * chunk))
        .until(Message::Started)
        .send(rays_frame(5, 0, chunk))
        .until(Message::Chunk)
        .say(5, credit)
        .send(rays_frame(5, chunk, chunk))
        .until(Message::Done)
        .say(6, render)
        .until(Message::Done)
        .say(7, query_of(1))
        .say(7, wire::CancelT{})
        .until(Message::Error)
        .say(8, wire::PingT{})
        .until(Message::Pong)
        .learnt();
}

/// Returns a file with one unit sphere.
std::string sphere_file() {
    std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 4), }";
    header.resize(117, ' ');
    const std::array<float, 4> sphere = {0, 0, 0, 1};
    std::string file("\x93NUMPY\x01\0\x76\0", 10);
    file += header + "\n";
    file.append(reinterpret_cast<const char*>(sphere.data()), sizeof sphere);
    return file;
}

/// A file of the running request, in one piece.
protocol::Frame upload_frame(std::uint64_t id, std::span<const std::byte> bytes) {
    protocol::Bulk bulk;
    bulk.add("data", wire::Dtype::u8, 1, bytes.size());
    bulk.allocate();
    std::memcpy(bulk.block(0).data(), bytes.data(), bytes.size());
    return protocol::encode(id, wire::UploadT{}, std::move(bulk)).value();
}

/// Uploads, imports and drops a scene.
Learnt upload(std::uint16_t port) {
    const std::string file = sphere_file();
    const auto bytes = std::as_bytes(std::span(file));
    wire::LoadT load;
    load.source = "points.npy";
    load.name = "sent";
    load.primitive = "sphere";
    load.file_names = {"points.npy"};
    load.file_hashes = {protocol::upload_checksum(bytes)};
    load.file_bytes = {bytes.size()};
    wire::UnloadT unload;
    unload.scene = "sent";
    Client client(port);
    return client.say(0, wire::HelloT{})
        .until(Message::Welcome)
        .say(5, load)
        .until(Message::Need)
        .send(upload_frame(5, bytes))
        .until(Message::Loaded)
        .say(6, unload)
        .until(Message::Unloaded)
        .learnt();
}

/// Loads a scene, moves and hides a part of it, and drops it.
Learnt edit(std::uint16_t port) {
    wire::LoadT load;
    load.source = "builtin:forest?trees=2";
    load.name = "sent";
    load.replace = true;  // another client may have edited it before its network broke
    std::array<protocol::EditRow, 2> rows{};
    rows[0] = {protocol::EditRow::move,
               0,
               protocol::EditRow::number,
               protocol::EditRow::world,
               {1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0}};
    rows[1] = {protocol::EditRow::set_mask, 0, protocol::EditRow::text, 2, {}};
    wire::EditT edit;
    edit.scene = "sent";
    edit.rows = rows.size();
    edit.targets = {"birch-*"};
    wire::UnloadT unload;
    unload.scene = "sent";
    Client client(port);
    return client.say(0, wire::HelloT{})
        .until(Message::Welcome)
        .say(5, load)
        .until(Message::Loaded)
        .say(6, edit)
        .send(upload_frame(6, std::as_bytes(std::span(rows))))
        .until(Message::Edited)
        .say(7, unload)
        .until(Message::Unloaded)
        .learnt();
}

struct Script {
    Learnt (*run)(std::uint16_t port);
    std::vector<Point> points;
};

std::vector<Script> scripts() {
    using enum Part;
    return {
        {trace,
         {{Message::Hello, header},   {Message::Hello, control},    {Message::Query, header},
          {Message::Query, control},  {Message::QueryRays, header}, {Message::QueryRays, control},
          {Message::QueryRays, bulk}, {Message::Credit, header},    {Message::Credit, control},
          {Message::Render, header},  {Message::Render, control},   {Message::Cancel, header},
          {Message::Ping, control},   {Message::Welcome, header},   {Message::Welcome, control},
          {Message::Started, header}, {Message::Started, control},  {Message::Chunk, header},
          {Message::Chunk, control},  {Message::Chunk, bulk},       {Message::Done, header},
          {Message::Done, control},   {Message::Payload, header},   {Message::Payload, control},
          {Message::Payload, bulk},   {Message::Error, header},     {Message::Error, control},
          {Message::Pong, control}}},
        {upload,
         {{Message::Load, header},
          {Message::Load, control},
          {Message::Need, control},
          {Message::Upload, header},
          {Message::Upload, control},
          {Message::Upload, bulk},
          {Message::Loaded, header},
          {Message::Loaded, control}}},
        {edit,
         {{Message::Edit, header},
          {Message::Edit, control},
          {Message::Upload, header},
          {Message::Upload, bulk},
          {Message::Edited, header},
          {Message::Edited, control}}}};
}

std::uint64_t seeds() {
    const char* wanted = std::getenv("RAYNEST_CHAOS_SEEDS");
    if (wanted != nullptr) return std::stoull(wanted);
    if (sanitized) return 10;
    return std::getenv("RAYNEST_LONG") != nullptr ? 100 : 30;
}

/// The state that must return once the clients are gone.
struct Idle {
    double memory;
    std::size_t descriptors;
};

void check_idle(Served& served, const Idle& idle) {
    Peer& peer = served.peer;
    CHECK(eventually([&] {
        return counter(peer, "connections_accepted") == counter(peer, "connections_closed") + 1;
    }));
    CHECK(eventually([&] { return counter(peer, "jobs_started") == counter(peer, "jobs_ended"); }));
    // An abandoned import still ends, and a published scene stays.
    wire::UnloadT unload;
    unload.scene = "sent";
    REQUIRE(peer.say(4, unload));
    while (peer.read().value().header.request_id != 4) {
    }
    CHECK(eventually([&] { return counter(peer, "memory_used_bytes") == idle.memory; }));
    CHECK(eventually([&] { return served.daemon.descriptors() == idle.descriptors; }));
    CHECK(peer.answers());
}

TEST_CASE_FIXTURE(Served, "whatever the network does at any point, the daemon releases it all") {
    const Idle idle = {counter(peer, "memory_used_bytes"), daemon.descriptors()};
    std::array<std::size_t, harm_count> harms{};
    std::size_t points = 0;
    for (const Script& script : scripts()) {
        const Learnt undisturbed = script.run(daemon.port());
        REQUIRE(undisturbed.has_value());
        for (const Point& point : script.points) {
            INFO(point.name());
            ++points;
            for (std::uint64_t seed = 1; seed <= seeds(); ++seed) {
                INFO("seed ", seed);
                ChaosProxy proxy(daemon.port(), point, 1000 * points + seed);
                const Learnt learnt = script.run(proxy.port());
                CHECK(proxy.struck());
                if (proxy.harmless()) CHECK(learnt == undisturbed);
                ++harms[static_cast<std::size_t>(proxy.harm())];
            }
            check_idle(*this, idle);
        }
    }
    CHECK(points >= 30);
    std::ostringstream done;
    for (std::size_t i = 0; i < harm_count; ++i)
        done << ' ' << harm_name(static_cast<Harm>(i)) << ' ' << harms[i];
    tally("conversations through a bad network", points * seeds(),
          std::to_string(points) + " points:" + done.str() + "; everything is released");
}

}  // namespace
}  // namespace raynest::test
