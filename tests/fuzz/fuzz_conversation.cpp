// Runs the connection's state machine, frames in and frames out, without sockets and threads.
//
// The input is a program of steps: a byte chooses the next action of the client or of the daemon's
// surroundings, and the bytes after it are its arguments. Most frames are valid, so that programs
// get deep; any of them may be damaged in transit. The last byte chooses the role of the client. A
// model of the promises to a client checks the daemon's frames, and that no role gets more than it
// may. The daemon stays from one input to the next. What the client may change, the scene "mine", is
// loaded anew for each, so that an input does the same whatever came before it.
#include "protocol/text.h"
#include "tests/fuzz/client_messages.h"
#include "tests/fuzz/target.h"
#include "tests/golden/examples.h"
#include "tests/unit/server/small_daemon.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

using namespace raynest;
using namespace raynest::fuzz;

namespace {

constexpr std::size_t steps_max = 200;

protocol::Limits small_limits() {
    protocol::Limits limits;
    limits.chunk_rays_max = 64;
    limits.window_bytes = 64 << 10;
    limits.picture_pixels_max = 4096;
    limits.upload_bytes_max = 1 << 20;
    return limits;
}

// ---- promises to a client

/// The least role that may receive an answer of this type.
server::Role role_of_answer(std::uint16_t type) {
    switch (static_cast<wire::Message>(type)) {
        case wire::Message::Need:
        case wire::Message::Loaded:
        case wire::Message::Unloaded:
        case wire::Message::Edited:
            return server::Role::user;
        case wire::Message::AdminReport:
            return server::Role::admin;
        default:
            return server::Role::viewer;
    }
}

/// Checks that frames of a request come between its start and its end, that its rays are answered
/// once, and that answers never exceed its credit.
class Model {
public:
    explicit Model(server::Role role) : role_(role) {}
    void greeted(std::uint64_t window) { window_ = window; }
    void granted(std::uint64_t id, std::uint64_t bytes) { requests_[id].credit += bytes; }
    /// Begins a request whose answer has no Started.
    void begun(std::uint64_t id) {
        if (!requests_[id].running) requests_[id] = {true, window_, 0};
    }

    void check(const protocol::Frame& frame, const server::Runner& runner) {
        fuzz::require(golden::open_any(frame).has_value());
        fuzz::require(role_ >= role_of_answer(frame.header.type));
        Request& request = requests_[frame.header.request_id];
        switch (static_cast<wire::Message>(frame.header.type)) {
            case wire::Message::Started:
                request = {true, window_, 0};
                return;
            case wire::Message::Chunk:
                request.rays += protocol::open<wire::Chunk>(frame).value()->count();
                return spend(request, frame.header.bulk_bytes);
            case wire::Message::Payload:
                return spend(request, frame.header.bulk_bytes);
            case wire::Message::Done: {
                const auto done = protocol::open<wire::Done>(frame).value();
                fuzz::require(request.running &&
                              (request.rays == 0 || request.rays == done->rays()));
                fuzz::require(done->rays() >= done->misses());
                request.running = false;
                return;
            }
            case wire::Message::Error:
                // A refused second use of an id does not end the first.
                request.running = request.running && runner.knows(frame.header.request_id);
                return;
            case wire::Message::Edited: {
                const auto edited = protocol::open<wire::Edited>(frame).value();
                fuzz::require(edited->epoch() == ++epoch_);
                return;
            }
            default:
                return;
        }
    }

private:
    struct Request {
        bool running = false;
        std::uint64_t credit = 0;
        std::uint64_t rays = 0;
    };
    static void spend(Request& request, std::uint64_t bytes) {
        fuzz::require(request.running && bytes <= request.credit);
        request.credit -= bytes;
    }

    const server::Role role_;
    std::uint64_t window_ = 0;
    std::uint64_t epoch_ = 1;  ///< the epoch of scene "mine"
    std::map<std::uint64_t, Request> requests_;
};

/// The scene "mine" of the client's principal, while an input runs.
class OwnScene {
public:
    explicit OwnScene(test::SmallDaemon& daemon) : daemon_(daemon) {
        static const std::shared_ptr<const Snapshot> scene = test::build_scene(test::tree_scene());
        const auto made = daemon_.scenes.publish("mine", scene, {.temporary = true}, caller_);
        fuzz::require(made && made->epoch == 1);
    }
    ~OwnScene() { daemon_.scenes.disconnect(caller_); }
    OwnScene(const OwnScene&) = delete;

private:
    test::SmallDaemon& daemon_;
    const server::ConnectionId caller_{"me", daemon_.scenes.connect()};
};

class Connection {
public:
    Connection(test::SmallDaemon& daemon, server::Role role)
        : daemon_(daemon),
          conversation_(daemon, "me", role),
          role_(role),
          model_(role) {}
    ~Connection() {
        conversation_.abandon();
        daemon_.sent.clear();
        daemon_.settle();
        fuzz::require(daemon_.sent.empty());
    }
    Connection(const Connection&) = delete;

    [[nodiscard]] bool closing() const { return conversation_.closing(); }

    void step(Program& program) {
        const std::uint8_t what = program.byte();
        const std::uint64_t id = 1 + program.below(ids);
        if (auto frame = next_frame(what % 32, id, program)) {
            if (what >= 224) damage(program, *frame);
            receive(std::move(*frame));
        } else {
            surroundings(what % 32, program);
        }
        conversation_.settle();
        for (const protocol::Frame& frame : daemon_.sent)
            model_.check(frame, conversation_.runner());
        daemon_.sent.clear();
    }

private:
    std::optional<protocol::Frame> next_frame(std::uint8_t what, std::uint64_t id,
                                              Program& program) {
        const auto say = [&](const auto& message) { return protocol::encode(id, message).value(); };
        switch (what) {
            case 0:
            case 1:
                sent_rays_[id] = 0;
                return say(query(program));
            case 2:
            case 3:
            case 4: {
                const std::uint64_t first = sent_rays_[id];
                protocol::Frame frame = rays(program, id, first);
                sent_rays_[id] += frame.header.bulk_bytes / sizeof(Ray);
                return frame;
            }
            case 5:
                return rays(program, id, program.byte());
            case 6: {
                wire::CreditT credit;
                credit.bytes = 1 + (std::uint64_t{program.byte()} << program.below(16));
                return say(credit);
            }
            case 7:
                return say(wire::CancelT{});
            case 8:
                return say(picture<wire::RenderT>(program));
            case 9: {
                auto heatmap = picture<wire::HeatmapT>(program);
                heatmap.count = program.word<2>({"traversed", "necessary"});
                return say(heatmap);
            }
            case 10:
                return say(load(program));
            case 11:
                return upload(program, id);
            case 12:
            case 13:
                return example(program);
            case 14:
                return say(export_of(program));
            case 15: {
                const wire::EditT message = edit(program);
                edits_[id] = {message.rows, message.vertex_counts.empty() ? 0U : 4U};
                return say(message);
            }
            case 16:
                return edit_rows(program, id, edits_[id].first, edits_[id].second);
            default:
                return std::nullopt;
        }
    }

    void receive(protocol::Frame frame) {
        // Administrators may edit any scene, and that of the examples is for all inputs.
        const auto edited = protocol::open<wire::Edit>(frame);
        if (edited && protocol::text((*edited)->scene()) == "forest") return;
        const bool greeted = conversation_.greeted();
        const auto credit = protocol::open<wire::Credit>(frame);
        if (credit) model_.granted(frame.header.request_id, (*credit)->bytes());
        if (protocol::open<wire::Structure>(frame)) model_.begun(frame.header.request_id);
        const auto hello = protocol::open<wire::Hello>(frame);
        const std::uint64_t window = hello ? (*hello)->window_bytes() : 0;
        const server::Request* request = server::find_request(frame.header.type);
        const bool is_refused =
            request != nullptr && role_ < request->role && greeted && !conversation_.closing();
        const std::size_t jobs = conversation_.jobs();
        const std::size_t sent = daemon_.sent.size();
        const auto admitted = conversation_.admit(frame.header);
        if (!admitted) return conversation_.close_with_error(admitted.error());
        if (!*admitted) frame.bulk = {};  // skipped, as the decoder does
        conversation_.receive(std::move(frame));
        if (is_refused)
            fuzz::require(conversation_.jobs() <= jobs && daemon_.sent.size() > sent &&
                          daemon_.sent[sent].header.type ==
                              static_cast<std::uint16_t>(wire::Message::Error));
        if (!greeted && conversation_.greeted())
            model_.greeted(window == 0 ? daemon_.limits.window_bytes : window);
    }

    /// Simulates events around the conversation: workers, the socket, the clock, the operator.
    void surroundings(std::uint8_t what, Program& program) {
        switch (what) {
            case 28:
                daemon_.waiting = program.below(4) * daemon_.limits.window_bytes / 2;
                return conversation_.runner().pump();
            case 29:
                return conversation_.runner().tick(server::Clock::now() +
                                                   std::chrono::seconds(program.below(70)));
            case 30:
                return daemon_.settle();
            case 31:
                return program.byte() == 255 ? conversation_.drain() : daemon_.settle();
            default:
                static_cast<void>(daemon_.step());
        }
    }

    test::SmallDaemon& daemon_;
    test::Client conversation_;
    const server::Role role_;
    Model model_;
    std::map<std::uint64_t, std::uint64_t> sent_rays_;
    std::map<std::uint64_t, std::pair<std::uint32_t, std::uint32_t>> edits_;  ///< rows, vertices
};

/// Most programs are those of a user.
server::Role role_of(const std::uint8_t* data, std::size_t size) {
    constexpr std::array roles = {server::Role::user, server::Role::viewer, server::Role::admin,
                                  server::Role::user};
    return size == 0 ? server::Role::user : roles[data[size - 1] % roles.size()];
}

}  // namespace

std::vector<fuzz::Input> fuzz::seeds() {
    // Hello, then: two queries with their rays; two pictures; an upload; a query without rays; the
    // two exports of a scene, the first one's credit in two parts; two edits beside a query of what
    // they change, and edits that add a scene, deform a mesh, and are refused.
    const Input hello = {12, 0, 0, 7};
    const std::vector<Input> programs = {
        {0, 1, 0, 0, 0, 0, 1, 0, 0, 3, 0, 1, 2, 7, 5, 2, 1, 5, 3, 3, 5, 0, 0, 0, 2, 8, 30, 0},
        {0, 1, 2, 1, 1, 1, 1, 0, 2, 1, 7, 99, 2, 2, 1, 2, 3, 3, 5, 0, 0, 0, 2, 8, 30, 0},
        {8, 2, 0, 0, 0, 0, 1, 0, 15, 7, 30, 0, 6, 2, 255, 12, 30, 0},
        {9, 3, 0, 0, 0, 0, 1, 0, 63, 31, 1, 28, 0, 3, 30, 0, 28, 0, 0, 30, 0},
        {10, 2, 0, 1, 2, 1, 2, 11, 2, 0, 0, 1, 11, 2, 1, 0, 2, 30, 0},
        {0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 9, 29, 0, 61, 7, 1, 31, 0, 255},
        {14, 1, 0, 0, 0, 0, 30, 0, 6, 1, 255, 12, 30, 0, 14, 2, 0, 1, 0, 0, 30, 0},
        {15, 1, 0, 0,  1, 1, 1, 0, 0, 0, 0, 16, 1, 1, 1, 0, 0, 0, 2,  2, 0, 1,
         3,  0, 0, 15, 2, 0, 0, 0, 0, 0, 0, 0,  0, 0, 0, 1, 0, 0, 1,  0, 4, 0,
         0,  0, 9, 16, 2, 3, 0, 2, 0, 0, 0, 2,  0, 0, 0, 0, 2, 8, 30, 0},
        {15, 1,  0, 0,  0, 1, 1, 0, 0, 0, 16, 1, 4, 0,  0, 1, 0, 3, 6, 0, 2, 5,  0,
         0,  30, 0, 15, 2, 0, 2, 0, 0, 0, 0,  1, 0, 16, 2, 7, 0, 0, 0, 0, 0, 30, 0},
        {15, 1, 0, 0, 1,  0, 0,  0, 1, 0, 0, 16, 1, 5, 1, 0, 0,  0, 0, 0, 1, 2, 0, 1, 2,  0, 1,
         2,  0, 1, 2, 30, 0, 15, 2, 0, 0, 0, 0,  0, 0, 0, 0, 16, 2, 0, 0, 0, 0, 7, 0, 30, 0},
    };
    std::vector<Input> seeds;
    for (const Input& program : programs) {
        seeds.push_back(hello);
        seeds.back().insert(seeds.back().end(), program.begin(), program.end());
    }
    return seeds;
}

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static test::SmallDaemon daemon(small_limits());
    static const std::uint64_t idle_bytes = daemon.used_bytes();
    Program program({data, size});
    daemon.waiting = 0;
    {
        const OwnScene mine(daemon);
        Connection connection(daemon, role_of(data, size));
        for (std::size_t step = 0; step < steps_max && !program.ended() && !connection.closing();
             ++step)
            connection.step(program);
    }
    fuzz::require(daemon.metrics.jobs_started == daemon.metrics.jobs_ended);
    fuzz::require(daemon.admission.active() == 0);
    fuzz::require(daemon.used_bytes() == idle_bytes);
    return 0;
}
