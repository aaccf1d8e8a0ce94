#include "client/output/ranking.h"

#include "client/ground/text.h"
#include "client/output/output.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <vector>

namespace raynest::client {
namespace {

using Table = std::vector<std::vector<std::string>>;

template <class... Numbers>
std::string formatted(const char* format, Numbers... numbers) {
    std::array<char, 64> text{};
    std::snprintf(text.data(), text.size(), format, numbers...);
    return text.data();
}

std::string percent(const Json& share) {
    return formatted("%.1f %%", 100 * share.get<double>());
}

std::string name_text(const Json& row) {
    const Json& name = row.at("name");
    if (!name.is_string()) return "(none)";
    if (!name.get<std::string>().empty()) return name.get<std::string>();
    // As raynest info --meshes calls it.
    return row.contains("index") ? "#" + row.at("index").dump() : "(without a name)";
}

/// Rows, what they leave out, and what belongs to none: 100 % together.
void print_part(const std::string& title, const char* number, const Json& part,
                const char* remainder, std::ostream& to) {
    if (part.at("rows").empty()) return;
    Table table{{title, number, "SHARE", "WASTED", "WORK/RAY", "RAYS"}};
    for (const Json& row : part.at("rows")) {
        std::string name = name_text(row);
        if (row.contains("mesh") && row.at("mesh") != row.at("name"))
            name += " (" + row.at("mesh").get<std::string>() + ")";
        table.push_back({name, row_number(row), percent(row.at("share")), percent(row.at("wasted")),
                         formatted("%.1f", row.at("work_per_ray").get<double>()),
                         grouped(row.at("rays").get<std::uint64_t>())});
    }
    const auto others = part.at("others").at("rows").get<std::uint64_t>();
    if (others != 0)
        table.push_back({"... " + grouped(others) + " more", "",
                         percent(part.at("others").at("share")), "", "", ""});
    table.push_back({remainder, "", percent(part.at("remainder").at("share")), "", "", ""});
    print_table(table);
    to << '\n';
}

void print_findings(const Json& findings, std::ostream& to) {
    if (findings.empty()) {
        to << "diagnosis: nothing found\n";
        return;
    }
    to << "diagnosis:\n";
    for (const Json& finding : findings) {
        std::string name = finding.at("finding").get<std::string>();
        std::ranges::replace(name, '_', ' ');
        const std::string subject = finding.at("subject").get<std::string>();
        to << "  " << name << (subject.empty() ? "" : " in '" + subject + "'")
           << subject_number(finding) << ": "
           << formatted("%.3g", finding.at("figure").get<double>()) << ' '
           << finding.at("unit").get<std::string>() << ", should not be "
           << finding.at("side").get<std::string>() << ' '
           << formatted("%.3g", finding.at("threshold").get<double>()) << "; "
           << percent(finding.at("share")) << " of all work; "
           << finding.at("remedy").get<std::string>() << '\n';
    }
}

}  // namespace

void print_ranking(const Json& received, std::ostream& to) {
    const Json document = shown_json(received);
    const Json& total = document.at("total");
    to << grouped(document.at("rays").get<std::uint64_t>()) << " rays of camera '"
       << document.at("camera").get<std::string>() << "' tested "
       << grouped(total.at("boxes").get<std::uint64_t>()) << " boxes and "
       << grouped(total.at("prims").get<std::uint64_t>())
       << " primitives. WASTED: the part of a row's work on rays that hit nothing in it\n\n";
    const Json& level = document.at("level");
    const std::string instances =
        level.is_null() ? "INSTANCE" : "INSTANCE OF LEVEL " + std::to_string(level.get<int>());
    print_part(instances, "PATH", document.at("instances"), "trees above", to);
    print_part("MESH", "OBJECT", document.at("meshes"), "trees of instances alone", to);
    print_part("MATERIAL (primitives)", "NUMBER", document.at("materials"), "boxes", to);
    print_findings(document.at("findings"), to);
}

std::string row_number(const Json& row) {
    if (!row.contains("path"))
        return row.contains("index") && row.at("index").is_number()
                   ? std::to_string(row.at("index").get<std::uint64_t>())
                   : "";
    const auto first = row.at("path").get<std::uint64_t>();
    const auto count = row.at("placements").get<std::uint64_t>();
    const std::string text = std::to_string(first);
    return count < 2 ? text : text + ".." + std::to_string(first + count - 1);
}

std::string subject_number(const Json& finding) {
    for (const char* kind : {"object", "material"})
        if (finding.contains(kind) && finding.at(kind).is_number())
            return std::string(" (") + kind + " " +
                   std::to_string(finding.at(kind).get<std::uint64_t>()) + ")";
    return "";
}

}  // namespace raynest::client
