#include "server/jobs/films/light_notes.h"

#include "engine/scene/precision.h"
#include "protocol/text.h"

#include <utility>

namespace raynest::server {

std::vector<std::string> light_notes(const Integrator& integrator, const Snapshot& scene,
                                     const protocol::Limits& limits) {
    std::vector<std::string> notes;
    for (const std::string& note : integrator.notes())
        notes.push_back(protocol::clean_text(note, limits.text_bytes_max));
    if (std::string warning = light_warning(scene.origin(), scene.bounds()); !warning.empty())
        notes.push_back(std::move(warning));
    return notes;
}

}  // namespace raynest::server
