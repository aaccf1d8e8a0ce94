#include "server/requests/words/render_words.h"

#include "protocol/control.h"
#include "server/requests/words/generator.h"

namespace raynest::server {

RenderWords render_words(const wire::Render& message) {
    RenderWords words;
    words.job = job_words(protocol::present(message.job()));
    words.camera = camera_request(message.camera());
    words.pixels = asked_pixels(message);
    words.integrator = protocol::word(message.integrator(), "primary");
    words.samples = message.samples();
    words.seed = message.seed();
    words.encode = protocol::word(message.encode(), "png");
#define RAYNEST_INTEGRATOR_SETTING(name, ...) words.name = message.name();
#include "engine/integrators/integrator_settings.def"
    words.environment = protocol::word(message.environment(), "auto");
    words.sun = message.sun();
    words.sun_azimuth = message.sun_azimuth();
    words.sun_elevation = message.sun_elevation();
    words.tonemap = protocol::text(message.tonemap());
    words.exposure = protocol::text(message.exposure());
    words.best_by_ms = message.best_by_ms();
    words.progressive = message.progressive();
    words.noise = message.noise();
    words.resume_bytes = message.resume_bytes();
    words.environment_bytes = message.environment_bytes();
    words.environment_rotate = message.environment_rotate();
    return words;
}

}  // namespace raynest::server
