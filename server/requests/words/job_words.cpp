#include "server/requests/words/job_words.h"

#include "protocol/control.h"

namespace raynest::server {
namespace {

template <class T>
std::vector<T> list(const flatbuffers::Vector<T>* ids) {
    return ids == nullptr ? std::vector<T>() : std::vector<T>(ids->begin(), ids->end());
}

}  // namespace

JobWords job_words(const wire::Job& job) {
    using protocol::text;
    using protocol::word;
    JobWords words;
    words.scene = text(job.scene());
    words.epoch = job.epoch();
    words.intersector = word(job.intersector(), "auto");
    words.settings = protocol::strings(job.settings());
    if (job.tables() != nullptr) {
        for (const wire::ParamTable* table : *job.tables()) {
            const auto values = protocol::values(*table);
            words.tables.push_back(
                {std::string(text(table->name())), {values.begin(), values.end()}});
        }
    }
    words.traversal = word(job.traversal(), "auto");
    words.mask = job.mask();
    words.worker = word(job.worker(), "auto");
    words.priority = word(job.priority(), "normal");
    words.deadline_ms = job.deadline_ms();
    words.detach = job.detach();
    words.selection = {{list(job.hidden_instances()), list(job.hidden_objects()),
                        list(job.only_instances()), list(job.only_objects())},
                       {protocol::strings(job.hidden_paths()), list(job.hidden_path_ids())},
                       {protocol::strings(job.only_paths()), list(job.only_path_ids())},
                       job.skip_hidden_boxes()};
    words.moment = moment_words(job);
    return words;
}

}  // namespace raynest::server
