#include "server/sessions/conversation.h"

#include "protocol/answer.h"
#include "protocol/text.h"
#include "server/ground/io_turn.h"
#include "server/ground/limited_log.h"
#include "server/ground/refusals.h"
#include "server/jobs/change_gate.h"
#include "server/scheduling/dispatched_task.h"
#include "server/scheduling/peers.h"
#include "server/security/access.h"
#include "server/store/scene_store.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <exception>
#include <iterator>
#include <new>
#include <utility>
#include <vector>

namespace raynest::server {
namespace {

/// Minimum window: it holds the answer of one ray with 256 hits and all columns.
constexpr std::uint64_t window_bytes_min = 64ULL << 10;
/// Time for a Fetch after a Wait, while the daemon ends.
constexpr std::chrono::seconds fetch_time{2};

/// An administrator reads at `info` who was kept from what, and at `error` what went wrong here.
LogLevel level_of(Code refusal) {
    switch (refusal) {
        case Code::internal:
            return LogLevel::error;
        case Code::not_allowed:
        case Code::quota:
        case Code::resource_exhausted:
            return LogLevel::info;
        default:
            return LogLevel::debug;
    }
}

std::uint64_t no_bulk(const protocol::Limits& /*limits*/) {
    return 0;
}
std::uint64_t one_window(const protocol::Limits& limits) {
    return limits.window_bytes;
}
std::uint64_t one_chunk_of_rays(const protocol::Limits& limits) {
    return limits.chunk_rays_max * sizeof(Ray) +
           protocol::padded(limits.chunk_rays_max * sizeof(std::uint32_t));
}

}  // namespace

/// Any role may send the parts of a request: without the request itself they do nothing.
struct Conversation::Part {
    wire::Message type;
    bool before_hello;  ///< true: allowed only before Hello is answered; false: only after
    /// Returns the maximum bytes of the bulk part; 0: the message has none.
    std::uint64_t (*bulk_bytes_max)(const protocol::Limits&);
    void (Conversation::*act)(protocol::Frame);
};

struct Conversation::Parts {
    static constexpr Part rows[] = {
        Part{wire::Message::Hello, true, no_bulk, &Conversation::greet},
        Part{wire::Message::Ping, false, no_bulk, &Conversation::ping},
        Part{wire::Message::Cancel, false, no_bulk, &Conversation::cancel},
        Part{wire::Message::Credit, false, no_bulk, &Conversation::credit},
        Part{wire::Message::Upload, false, one_window, &Conversation::feed},
        Part{wire::Message::QueryRays, false, one_chunk_of_rays, &Conversation::feed},
    };

    /// Returns the place of a row, or their number. With -fsanitize=undefined, GCC takes no address
    /// of a row for a constant, so that this has none.
    static constexpr std::size_t find(std::uint16_t type) {
        std::size_t at = 0;
        while (at != std::size(rows) && static_cast<std::uint16_t>(rows[at].type) != type) ++at;
        return at;
    }
};

const Conversation::Part* Conversation::find_part(std::uint16_t type) {
#define RAYNEST_PART(number, Name, ...)                          \
    static_assert(Parts::find(number) != std::size(Parts::rows), \
                  "the table has no row "                        \
                  "for " #Name);
#include "protocol/lists/requests.def"
    const std::size_t at = Parts::find(type);
    return at == std::size(Parts::rows) ? nullptr : &Parts::rows[at];
}

Conversation::Conversation(const Services& services, const JobContext& context, Sink& sink,
                           std::string peer, Authenticate authenticate)
    : services_(services),
      sink_(sink),
      authenticate_(std::move(authenticate)),
      runner_(std::make_shared<Runner>(context, sink, peer)) {
    caller_.principal = std::move(peer);
    caller_.connection = services_.scenes.connect();
}

Reply<bool> Conversation::admit(const protocol::FrameHeader& header) {
    if (!protocol::message_known(header.type)) return false;
    const Part* part = find_part(header.type);
    const std::uint64_t most = part == nullptr ? 0 : part->bulk_bytes_max(services_.limits);
    if (most == 0 && header.bulk_bytes != 0)
        return refuse(Code::limit_exceeded,
                      protocol::message_name(header.type) + " brings no bulk part; " +
                          std::to_string(header.bulk_bytes) + " bytes are announced");
    return header.bulk_bytes <= most && cover(header);
}

void Conversation::receive(protocol::Frame frame) {
    if (closing_) return;
    services_.metrics.count<&Metrics::frames_received>(counted_as());
    guard(frame.header.request_id, [&] { handle(std::move(frame)); });
    if (!held_up_) arriving_ = {};
    settle();
}

void Conversation::guard(std::uint64_t id, const std::function<void()>& act) {
    const RequestScope scope({caller_.connection, id});
    const WorksForPeer working(works_);
    // A greeting that has failed half-way ends the connection.
    const auto refuse_one = [&](const protocol::Error& error) {
        if (greeted_) return refuse_request(id, error);
        close_with_error(error);
    };
    try {
        act();
    } catch (const std::bad_alloc&) {
        refuse_one({Code::resource_exhausted, "", 0});
    } catch (const std::exception& error) {
        refuse_one({Code::internal, error.what(), 0});
    }
}

void Conversation::refuse_unreadable(const Unreadable& message) {
    if (closing_) return;
    if (message.closes || !greeted_) return close_with_error(message.error);
    const std::uint64_t id = message.request_id;
    const RequestScope scope({caller_.connection, id});
    const bool is_part = find_part(message.type) != nullptr;
    if (const auto parked = parked_.find(id); is_part && parked != parked_.end())
        return refuse_parked(parked, message.error);
    if (is_part && runner_of(id).knows(id))
        runner_of(id).fail(id, message.error);
    else
        refuse_request(id, message.error);
    settle();
}

void Conversation::handle(protocol::Frame frame) {
    const std::uint16_t type = frame.header.type;
    IoTurn::handles(type);
    const Request* request = find_request(type);
    const Part* part = find_part(type);
    const bool greets = part != nullptr && part->before_hello;
    if (!greeted_ && !greets)
        return close_with_error(
            {Code::bad_frame, "expected Hello, got " + protocol::message_name(type), 0});
    if (!protocol::message_known(type))
        return refuse_request(
            frame.header.request_id,
            {Code::unknown_type, "this daemon does not know " + protocol::message_name(type), 0});
    if ((request == nullptr && part == nullptr) || (greeted_ && greets))
        return close_with_error({Code::bad_frame,
                                 protocol::message_name(type) + " is not for a client to send now",
                                 0});
    if (request != nullptr) return start(*request, std::move(frame));
    const auto parked = parked_.find(frame.header.request_id);
    if (parked != parked_.end() && type != static_cast<std::uint16_t>(wire::Message::Ping)) {
        if (type != static_cast<std::uint16_t>(wire::Message::Cancel)) {
            held_up_ = std::move(frame);
            return;
        }
        if (const auto cancel = protocol::open<wire::Cancel>(frame, services_.limits); !cancel)
            return refuse_parked(parked, cancel.error());
        return refuse_parked(parked, {Code::cancelled, "", 0});
    }
    (this->*part->act)(std::move(frame));
}

void Conversation::greet(protocol::Frame frame) {
    const auto hello = protocol::open<wire::Hello>(frame, services_.limits);
    if (!hello) return close_with_error(hello.error());
    if ((*hello)->version_min() > protocol::version_max ||
        (*hello)->version_max() < protocol::version_min)
        return close_with_error(
            {Code::unsupported_version,
             "this daemon speaks version " + std::to_string(protocol::version_min) + " to " +
                 std::to_string(protocol::version_max) + " of the protocol, the client " +
                 std::to_string((*hello)->version_min()) + " to " +
                 std::to_string((*hello)->version_max()),
             0});
    const std::uint64_t window = (*hello)->window_bytes();
    if (window != 0 && window < window_bytes_min)
        return close_with_error(
            {Code::invalid_field,
             "window_bytes must be 0 or at least " + std::to_string(window_bytes_min), 0});
    Reply<Principal> principal = authenticate_(*(*hello).table);
    if (!principal) return close_with_error(principal.error());
    caller_.principal = principal->id;
    caller_.role = principal->role;
    caller_.window_bytes = window == 0 ? services_.limits.window_bytes : window;
    caller_.identity = std::move(*principal);
    runner_->set_principal(caller_.principal);
    runner_->set_window(caller_.window_bytes);
    greeted_ = true;

    wire::WelcomeT welcome;
    welcome.version = std::min<std::uint16_t>((*hello)->version_max(), protocol::version_max);
    welcome.server = "raynestd " RAYNEST_VERSION;
    welcome.window_bytes = services_.limits.window_bytes;
    welcome.frame_bytes_max = services_.limits.frame_bytes_max;
    welcome.chunk_rays_max = static_cast<std::uint32_t>(services_.limits.chunk_rays_max);
    welcome.jobs_max = static_cast<std::uint32_t>(services_.limits.jobs_max);
    welcome.principal = caller_.principal;
    welcome.role = role_name(caller_.role);
    sink_.send(protocol::answer(frame.header.request_id, welcome));
    log_limited(LogLevel::debug, "greeted", caller_.principal,
                {{"principal", caller_.principal},
                 {"client", std::string(protocol::text((*hello)->client()))}});
}

void Conversation::ping(protocol::Frame frame) {
    const std::uint64_t id = frame.header.request_id;
    const auto ping = protocol::open<wire::Ping>(frame, services_.limits);
    if (!ping) return refuse_request(id, ping.error());
    wire::PongT pong;
    pong.payload = (*ping)->payload();
    sink_.send(protocol::answer(id, pong));
}

void Conversation::credit(protocol::Frame frame) {
    const std::uint64_t id = frame.header.request_id;
    const auto credit = protocol::open<wire::Credit>(frame, services_.limits);
    if (!credit) return runner_of(id).fail(id, credit.error());
    runner_->grant(id, (*credit)->bytes());
}

void Conversation::cancel(protocol::Frame frame) {
    const std::uint64_t id = frame.header.request_id;
    const auto cancel = protocol::open<wire::Cancel>(frame, services_.limits);
    if (!cancel) return runner_of(id).fail(id, cancel.error());
    if (const auto fed = feeding_.find(id); fed != feeding_.end())
        services_.detached.cancel(fed->second->record().number);
    else
        runner_->cancel(id);
}

void Conversation::start(const Request& request, protocol::Frame frame,
                         std::optional<Clock::time_point> deadline, Waits waits) {
    const std::uint64_t id = frame.header.request_id;
    if (id == 0 || runner_->knows(id) || feeding_.contains(id) || parked_.contains(id))
        return refuse_request(id, {Code::invalid_field,
                                   id == 0 ? "a request needs an id other than 0"
                                           : "the request id " + std::to_string(id) +
                                                 " is in use by a request under way",
                                   0});
    const std::string name = protocol::message_name(frame.header.type);
    if (const auto allowed = access::send_request(name, request.role, caller_.role); !allowed) {
        ++services_.metrics.requests_refused;
        log_limited(LogLevel::info, "request_refused", caller_.principal,
                    {{"principal", caller_.principal},
                     {"role", std::string(role_name(caller_.role))},
                     {"request", name}});
        return send_refusal(id, allowed.error());
    }
    caller_.request_id = id;
    (void)services_.scenes.take_asleep();
    if (services_.poser != nullptr) (void)services_.poser->take_wanted();
    Reply<Answer> answer = request.answer(services_, caller_, frame);
    const auto posed = services_.poser == nullptr ? std::nullopt : services_.poser->take_wanted();
    using Awake = std::weak_ptr<SceneWaker::Awake>;
    if (!answer && services_.waker != nullptr)
        if (const auto asleep = services_.scenes.take_asleep()) {
            if (const auto may = waits.once_more(asleep->facts.arena); !may)
                return refuse_request(id, may.error());
            return park(request, std::move(frame), deadline, std::move(waits), [&](Awake awake) {
                services_.waker->wake(*asleep, caller_.principal, std::move(awake));
            });
        }
    if (!answer && posed) {
        waits.hold(posed->found);
        return park(request, std::move(frame), deadline, std::move(waits), [&](Awake awake) {
            services_.poser->make(*posed, caller_.principal, std::move(awake));
        });
    }
    if (!answer) return refuse_request(id, answer.error());
    if (auto* frames = std::get_if<Frames>(&*answer)) {
        for (protocol::Frame& reply : *frames) sink_.send(std::move(reply));
        return;
    }
    JobSubmission accepted = std::move(std::get<JobSubmission>(*answer));
    const bool fetches = accepted.kind == "fetch";
    if (draining_ && !fetches) return refuse_request(id, {Code::draining, why_draining_, 0});
    if (services_.changes != nullptr && services_.changes->is_closed() &&
        ChangeGate::concerns(accepted.kind))
        return park(request, std::move(frame), deadline, std::move(waits),
                    [&](Awake awake) { services_.changes->wait(std::move(awake)); });
    if (const auto room = check_room(); !room) return refuse_request(id, room.error());
    if (deadline) accepted.deadline_ms = milliseconds_until(*deadline, Clock::now());
    waited_ = !fetches && (waited_ || accepted.kind == "wait");
    if (accepted.detach) {
        if (const auto detached = detach(id, std::move(accepted)); !detached)
            refuse_request(id, detached.error());
        return;
    }
    if (const auto started = runner_->start(id, std::move(accepted)); !started)
        refuse_request(id, started.error());
}

Reply<void> Conversation::check_room() const {
    if (in_flight() < services_.limits.jobs_max) return {};
    services_.metrics.count<&Metrics::jobs_refused>(caller_.principal);
    return refuse(Code::quota, "this connection has " + std::to_string(in_flight()) +
                                   " requests in flight, the limit is jobs_max = " +
                                   std::to_string(services_.limits.jobs_max) +
                                   "; wait for one of them, or open another connection");
}

void Conversation::park(const Request& request, protocol::Frame frame,
                        std::optional<Clock::time_point> deadline, Waits waits,
                        const std::function<void(std::weak_ptr<SceneWaker::Awake>)>& wait) {
    const std::uint64_t id = frame.header.request_id;
    if (const auto room = check_room(); !room) return refuse_request(id, room.error());
    const std::uint64_t bytes = frame.control.size() + frame.bulk.size();
    auto lease = services_.peers.reserve(bytes, caller_.principal);
    if (!lease)
        return refuse_request(
            id,
            services_.budget.refuse("the request", bytes, caller_.principal, "try later").value());
    if (!deadline)
        deadline = deadline_after(Clock::now(), request.deadline_ms(frame, services_.limits));
    auto awake = std::make_shared<SceneWaker::Awake>(
        [this, id](const Reply<void>& ready) { resume(id, ready); });
    auto slot = runner_->enter_parked(frame.header.type, *deadline, [weak = std::weak_ptr(awake)] {
        if (const auto waiting = weak.lock()) (*waiting)(refuse(Code::cancelled, ""));
    });
    if (!slot) return refuse_request(id, slot.error());
    parked_.emplace(id, Parked{std::move(frame), std::move(*lease), std::move(*slot), *deadline,
                               std::move(waits), awake});
    wait(std::move(awake));
}

void Conversation::resume(std::uint64_t id, const Reply<void>& ready) {
    const auto parked = parked_.find(id);
    if (!ready) return refuse_parked(parked, ready.error());
    protocol::Frame frame = std::move(parked->second.frame);
    const Clock::time_point deadline = parked->second.deadline;
    Waits waits = std::move(parked->second.waits);
    parked_.erase(parked);
    guard(id, [&] {
        start(*find_request(frame.header.type), std::move(frame), deadline, std::move(waits));
    });
    let_go_on();
}

void Conversation::refuse_parked(ParkedRequests::iterator parked, const protocol::Error& error) {
    const std::uint64_t id = parked->first;
    parked_.erase(parked);
    const RequestScope scope({caller_.connection, id});
    refuse_request(id, error);
    let_go_on();
}

void Conversation::let_go_on() {
    if (held_up_ && !parked_.contains(held_up_->header.request_id)) {
        protocol::Frame frame = std::move(*std::exchange(held_up_, std::nullopt));
        guard(frame.header.request_id, [&] { handle(std::move(frame)); });
        if (!held_up_) arriving_ = {};
    }
    settle();
    if (resumed_) resumed_();
}

void Conversation::expire_parked(Clock::time_point now) {
    std::vector<std::uint64_t> late;
    for (const auto& [id, parked] : parked_)
        if (now >= parked.deadline) late.push_back(id);
    // The first may end the connection, and the others with it.
    for (const std::uint64_t id : late)
        if (const auto parked = parked_.find(id); parked != parked_.end()) {
            ++services_.metrics.deadlines_passed;
            refuse_parked(parked, deadline_error());
        }
}

void Conversation::feed(protocol::Frame frame) {
    runner_of(frame.header.request_id).feed(std::move(frame));
}

Runner& Conversation::runner_of(std::uint64_t id) const {
    const auto fed = feeding_.find(id);
    return fed == feeding_.end() ? *runner_ : fed->second->runner();
}

Reply<void> Conversation::detach(std::uint64_t id, JobSubmission accepted) {
    const auto job = services_.detached.start(caller_.identity, id, std::move(accepted), &sink_);
    if (!job) return tl::unexpected(job.error());
    feeding_.emplace(id, *job);
    (*job)->set_feeder(&sink_);
    return {};
}

void Conversation::release_inputs() {
    for (auto fed = feeding_.begin(); fed != feeding_.end();) {
        const auto& [id, job] = *fed;
        if (job->runner().needs_client(id)) {
            ++fed;
            continue;
        }
        job->set_feeder(nullptr);
        // A failed job has already sent its error to the client.
        if (!job->error()) {
            wire::DetachedT detached;
            detached.job = job->record().number;
            sink_.send(protocol::answer(id, detached));
        }
        fed = feeding_.erase(fed);
    }
}

bool Conversation::waits_for_client() const {
    return works_ == 0 && parked_.empty() && runner_->waits_for_client() &&
           std::all_of(feeding_.begin(), feeding_.end(),
                       [](const auto& fed) { return fed.second->runner().waits_for_client(); });
}

void Conversation::abandon(const protocol::Error& why) {
    parked_.clear();
    // The decoder keeps a frame that is half here until the last error is sent.
    if (held_up_ || !closing_) arriving_ = {};
    held_up_.reset();
    runner_->abandon(why);
    services_.scenes.disconnect(caller_);
    for (const auto& [id, job] : std::exchange(feeding_, {})) {
        job->set_feeder(nullptr);
        services_.detached.cancel(job->record().number);
    }
}

void Conversation::refuse_request(std::uint64_t id, const protocol::Error& error) {
    log_limited(level_of(error.code), "refused", caller_.principal,
                {{"principal", caller_.principal},
                 {"code", std::string(protocol::error_info(error.code).name)},
                 {"message", error.message}});
    send_refusal(id, error);
}

void Conversation::send_refusal(std::uint64_t id, const protocol::Error& error) {
    ++refusals_of(services_.metrics, error.code);
    sink_.send(protocol::encode_error(id, for_client(error), false));
}

void Conversation::close_with_error(const protocol::Error& error) {
    if (closing_) return;
    if (error.code == Code::bad_frame || error.code == Code::limit_exceeded)
        ++services_.metrics.bad_frames;
    log_limited(LogLevel::debug, "closing", caller_.principal,
                {{"principal", caller_.principal},
                 {"code", std::string(protocol::error_info(error.code).name)},
                 {"message", error.message}});
    closing_ = true;
    // The daemon ends these requests itself, so the log must not blame their client.
    abandon({error.code, "", 0});
    sink_.send(protocol::encode_error(0, error, true));
}

void Conversation::drain(const std::string& why) {
    draining_ = true;
    why_draining_ = why;
    settle();
}

void Conversation::settle() {
    release_inputs();
    arriving_.settle();
    if (jobs() != 0) return;
    if (!draining_) {
        waited_ = false;
        return;
    }
    // A client that has waited for a job may still ask for its answer.
    if (waited_) {
        const Clock::time_point now = Clock::now();
        fetch_until_ = std::min(fetch_until_, now + fetch_time);
        if (now < fetch_until_) return;
    }
    close_with_error({Code::draining, why_draining_, 0});
}

}  // namespace raynest::server
