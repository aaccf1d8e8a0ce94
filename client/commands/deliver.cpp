#include "client/commands/deliver.h"

#include "client/files/files.h"
#include "client/files/points.h"
#include "client/ground/text.h"
#include "client/output/columns.h"
#include "client/output/outcome_text.h"
#include "client/output/output.h"
#include "client/output/output_file.h"
#include "client/output/query_rows.h"
#include "client/output/ranking.h"
#include "client/output/report.h"

#include <array>
#include <cstdio>
#include <iostream>
#include <utility>

namespace raynest::client {
namespace {

/// Differences are i32 in the fields of counts. Their range, and no other, begins below zero.
bool is_difference(const wire::HeatStatisticsT& heat) {
    return heat.range_low < 0;
}

std::int64_t value_of(const wire::HeatStatisticsT& heat, std::uint32_t field) {
    return is_difference(heat) ? std::int64_t{static_cast<std::int32_t>(field)}
                               : std::int64_t{field};
}

void print_statistics(const wire::HeatStatisticsT& heat, std::ostream& to) {
    const auto value = [&](std::uint32_t field) {
        return static_cast<long long>(value_of(heat, field));
    };
    const bool differs = is_difference(heat);
    std::array<char, 240> line;
    std::snprintf(line.data(), line.size(),
                  differs
                      ? "%s%s per ray, difference: min %+lld, mean %+.2f, p50 %+lld, p90 %+lld, "
                        "p99 %+lld, max %+lld, %.2f %% clipped"
                      : "%s%s per ray: min %lld, mean %.2f, p50 %lld, p90 %lld, p99 %lld, max "
                        "%lld, %.2f %% clipped",
                  heat.count == "necessary" ? "necessary " : "", heat.metric.c_str(),
                  value(heat.min), heat.mean, value(heat.p50), value(heat.p90), value(heat.p99),
                  value(heat.max), heat.clipped * 100);
    to << line.data();
    if (heat.below > 0) {
        std::snprintf(line.data(), line.size(), ", %.2f %% below the range", heat.below * 100);
        to << line.data();
    }
    to << '\n';
}

Json statistics_json(const wire::HeatStatisticsT& heat) {
    Json json{{"metric", heat.metric},
              {"min", value_of(heat, heat.min)},
              {"mean", heat.mean},
              {"p50", value_of(heat, heat.p50)},
              {"p90", value_of(heat, heat.p90)},
              {"p99", value_of(heat, heat.p99)},
              {"max", value_of(heat, heat.max)},
              {"clipped", heat.clipped},
              {"below", heat.below},
              {"count", heat.count},
              {"range_low", heat.range_low},
              {"range_high", heat.range_high}};
    if (is_difference(heat)) json["difference"] = true;
    return json;
}

/// Returns a consumer that prints rows of those columns of `first` that users asked for.
ChunkConsumer row_printer(const std::string& what, const QueryChunk& first, bool json) {
    if (const ReducerWords* reducer = find_reducer(what))
        return [rows = ReducedRows(reducer->rows == "points" ? "point" : "", json)](
                   const QueryChunk& chunk) mutable { return rows.print(chunk); };
    std::vector<std::string> shown;
    for (const protocol::BlockView& column : first.columns)
        if (first.shows(column.name)) shown.emplace_back(column.name);
    return [rows = QueryRows(what, shown, json)](const QueryChunk& chunk) mutable {
        return rows.print(chunk);
    };
}

/// Fails with the code for a partial answer if rays had more hits than --max-hits.
Result<void> check_whole(const Outcome& outcome) {
    if (outcome.truncated == 0) return {};
    return fail(Exit::partial, grouped(outcome.truncated) + " of " + grouped(outcome.rays) +
                                   " rays have more hits than --max-hits, of which the nearest "
                                   "were kept; raise it");
}

}  // namespace

Result<void> write_picture(const std::string& output, const ReceivedFile& picture) {
    if (picture.encode != "raw") return write_file(output, picture.bytes);
    const auto file = npy_file(picture, "|u1", {picture.height, picture.width, 4});
    if (!file) return tl::unexpected<Failure>(file.error());
    return write_file(output, *file);
}

Result<void> deliver_render(Context& context, const std::string& output, ReceivedFile picture,
                            std::uint32_t samples) {
    if (auto written = write_picture(output, picture); !written) return written;

    print_notes(picture.outcome);
    if (context.json)
        print_json(picture_json(output, picture), summary_of(output));
    else
        summary_of(output) << picture_text(output, picture) << '\n';
    if (!picture.outcome.incomplete) return {};
    std::string text = output + " has fewer samples than ";
    text += samples == 0 ? "were asked for"
                         : "the " + std::to_string(samples) + " per pixel that were asked for";
    if (picture.encode == "exr" && !is_stdout(output))
        text += "; raynest resume " + output + " --spp " +
                (samples == 0 ? "N" : std::to_string(samples)) + " adds the others";
    return fail(Exit::partial, std::move(text));
}

Result<void> deliver_heatmap(Context& context, const std::string& output, ReceivedFile picture,
                             std::span<const Verdict> checks) {
    if (!output.empty() && !is_report(output)) {
        if (picture.encode == "raw") {
            auto file = npy_file(picture, is_difference(picture.outcome.heat) ? "<i4" : "<u4",
                                 {picture.height, picture.width});
            if (!file) return tl::unexpected<Failure>(file.error());
            picture.bytes = std::move(*file);
        }
        if (auto written = write_file(output, picture.bytes); !written) return written;
    }

    print_notes(picture.outcome);
    std::ostream& to = summary_of(output);
    if (context.json) {
        Json json = statistics_json(picture.outcome.heat);
        json.update(picture_json(output, picture));
        if (!checks.empty()) json["checks"] = verdicts_json(checks);
        print_json(json, to);
    } else {
        to << (output.empty() ? outcome_text(picture.outcome) : picture_text(output, picture))
           << '\n';
        print_statistics(picture.outcome.heat, to);
        for (const Verdict& verdict : checks) to << verdict_text(verdict) << '\n';
    }
    return check_verdicts(checks);
}

Result<void> deliver_ranking(Context& context, const ReceivedFile& answer) {
    const auto document = read_json(answer);
    if (!document) return tl::unexpected<Failure>(document.error());
    print_notes(answer.outcome);
    if (context.json)
        print_json(*document);
    else
        print_ranking(*document, std::cout);
    return {};
}

Result<void> deliver_query(Context& context, const std::string& output, const std::string& what,
                           const std::function<Result<Outcome>(const ChunkConsumer&)>& ask,
                           const Json& part) {
    const bool rows = output.empty();
    if (!rows) {
        if (auto writable = check_writable(output); !writable) return writable;
    }
    ChunkConsumer print;
    Columns columns(has_splits(what));
    const auto outcome = ask([&](const QueryChunk& chunk) {
        if (!rows) return columns.append(chunk);
        if (!print) print = row_printer(what, chunk, context.json);
        context.progress.clear();
        return print(chunk);
    });
    context.progress.clear();
    if (!outcome) return tl::unexpected<Failure>(outcome.error());
    print_notes(*outcome);
    if (outcome->detached != 0) {
        print_detached(context, *outcome);
        return {};
    }
    if (rows) {
        if (outcome->rays == 0) print_note(outcome_text(*outcome));
        return check_whole(*outcome);
    }

    columns.complete(what);
    std::string said;
    if (!part.is_null()) {
        Json whole = part;
        whole["hash"] = outcome->hash;
        whole["epoch"] = outcome->epoch;
        // As arithmetic_of() of the engine's packs: others have FMA, and round once where v2 rounds twice.
        whole["arithmetic"] = outcome->target == "v2" ? "v2" : "v3";
        said = whole.dump();
    }
    const std::string ending = extension_of(output);
    const auto file = is_point_ending(ending) ? columns.points(ending)
                                              : Result<std::vector<std::byte>>(columns.npz(said));
    if (!file) return tl::unexpected<Failure>(file.error());
    if (auto written = write_file(output, *file); !written) return written;
    if (context.json) {
        Json json = outcome_json(*outcome);
        json["file"] = output;
        print_json(json, summary_of(output));
    } else {
        summary_of(output) << output << ": " << outcome_text(*outcome) << '\n';
    }
    return check_whole(*outcome);
}

Result<void> report_act(Context& context, const wire::AdminT& request) {
    const auto report = ask<wire::AdminReport>(context.connection, request);
    if (!report) return tl::unexpected<Failure>(report.error());
    const std::string text(protocol::text((*report)->text()));
    if (context.json)
        print_json(Json{{"text", text}});
    else
        std::cout << text << '\n';
    return {};
}

void print_detached(const Context& context, const Outcome& outcome) {
    if (context.json)
        print_json(Json{{"job", outcome.detached}});
    else
        std::cout << outcome.detached << '\n';
}

}  // namespace raynest::client
