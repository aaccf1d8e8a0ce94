#include "client/requests/job.h"

#include "client/ground/wording.h"
#include "client/requests/scene_origin.h"

#include <cmath>
#include <utility>

namespace raynest::client {
namespace {

template <class Notes>
void add_notes(const Notes* notes, Outcome& outcome) {
    for (const std::string& note : protocol::strings(notes))
        outcome.notes.push_back(localize_message(note));
}

}  // namespace

std::chrono::milliseconds deadline_of(double seconds) {
    return std::chrono::milliseconds(std::llround(seconds * 1000));
}

std::unique_ptr<wire::JobT> job_message(const JobOptions& options) {
    auto job = std::make_unique<wire::JobT>();
    job->scene = options.scene;
    job->epoch = options.epoch;
    job->intersector = options.intersector;
    job->settings = options.settings;
    for (const TableOption& table : options.tables) {
        job->tables.push_back(std::make_unique<wire::ParamTableT>());
        job->tables.back()->name = table.name;
        job->tables.back()->values = table.values;
    }
    job->traversal = options.traversal;
    job->mask = options.mask;
    job->worker = options.worker;
    job->priority = options.priority;
    job->detach = options.detach;
    add_selection(options, *job);
    put_moment(options, *job);
    job->deadline_ms = static_cast<std::uint32_t>(deadline_of(options.deadline).count());
    return job;
}

std::unique_ptr<wire::CameraT> camera_message(const CameraOptions& options,
                                              const WorldPoint& origin) {
    auto camera = std::make_unique<wire::CameraT>();
    camera->name = options.name;
    camera->fov_degrees = options.fov_degrees;
    const std::vector<double>& v = options.look_at;
    if (v.size() < 6) return camera;
    const auto vector = [&](std::size_t at, const WorldPoint& less) {
        return std::make_unique<wire::Vec3>(less_origin({v[at], v[at + 1], v[at + 2]}, less));
    };
    camera->look_at = true;
    camera->eye = vector(0, origin);
    camera->at = vector(3, origin);
    if (v.size() == 9) camera->up = vector(6, {});
    return camera;
}

Result<void> take_news(const protocol::Frame& frame, Outcome& outcome) {
    if (is<wire::Started>(frame)) {
        const auto opened = open_sent<wire::Started>(frame);
        if (!opened) return tl::unexpected<Failure>(opened.error());
        const wire::Started& started = *opened->table;
        if (std::exchange(outcome.has_started, true)) return daemon_sent("Started twice");
        outcome.scene = protocol::text(started.scene());
        outcome.hash = protocol::text(started.hash());
        outcome.camera = protocol::text(started.camera());
        outcome.intersector = protocol::text(started.intersector());
        outcome.target = protocol::text(started.target());
        outcome.traversal = protocol::text(started.traversal());
        outcome.worker = protocol::text(started.worker());
        outcome.epoch = started.epoch();
        outcome.origin = origin_of(started);
        outcome.rays_announced = started.rays();
        outcome.worker_reason = protocol::text(started.worker_reason());
        outcome.hidden = protocol::strings(started.hidden());
        add_notes(started.notes(), outcome);
    } else if (is<wire::Detached>(frame)) {
        const auto opened = open_sent<wire::Detached>(frame);
        if (!opened) return tl::unexpected<Failure>(opened.error());
        outcome.detached = (*opened)->job();
        if (!outcome.may_detach || outcome.detached == 0)
            return daemon_sent("the number of a detached job that was not asked for");
    } else if (is<wire::Done>(frame)) {
        const auto opened = open_sent<wire::Done>(frame);
        if (!opened) return tl::unexpected<Failure>(opened.error());
        const wire::Done& done = *opened->table;
        outcome.rays = done.rays();
        outcome.hits = done.hits();
        outcome.misses = done.misses();
        outcome.truncated = done.truncated();
        outcome.invalid = done.invalid();
        outcome.first_invalid = done.first_invalid();
        outcome.rows = done.rows();
        outcome.seconds = done.seconds();
        outcome.queued_seconds = done.queued_seconds();
        outcome.traversal = protocol::word(done.traversal(), outcome.traversal);
        // The reason belongs to the worker of STARTED; the notes tell why another one ran.
        if (const std::string ran(protocol::word(done.worker(), outcome.worker));
            ran != outcome.worker) {
            outcome.worker = ran;
            outcome.worker_reason.clear();
        }
        outcome.target = protocol::word(done.target(), outcome.target);
        add_notes(done.notes(), outcome);
        outcome.note_of_all = localize_message(std::string(protocol::text(done.note_of_all())));
        outcome.samples = done.samples();
        outcome.noise = done.noise();
        outcome.dropped = done.dropped();
        outcome.incomplete = done.incomplete();
        if (const wire::HeatStatistics* heat = done.heat()) heat->UnPackTo(&outcome.heat);
    }
    return {};
}

}  // namespace raynest::client
