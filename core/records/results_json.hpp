// Results as JSON. Apart from results.hpp, so that what only carries results does not read a JSON library.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/records/results.hpp"

namespace gpuphys {

nlohmann::json to_json(const RunResult&);
nlohmann::json to_json(const TimingResult&);
/// Throw Error(bad_input) naming `where` and the offending key.
RunResult run_result_from(const nlohmann::json&, const std::string& where);
TimingResult timing_result_from(const nlohmann::json&, const std::string& where);
nlohmann::json to_json(const ModuleStamp&);
ModuleStamp stamp_from(const nlohmann::json&, const std::string& where);

/// A number as JSON: non-finite ones become the strings "nan", "inf", "-inf", which JSON itself cannot hold.
nlohmann::json json_number(double);
double number_from(const nlohmann::json&, const std::string& where);

/// The JSON text of a file. Throws Error(bad_input).
nlohmann::json parse_json_file(const std::string& path);

// Members of an object; throw Error(bad_input) naming `where` and the key when it is missing or of another
// type.
const nlohmann::json& json_member(const nlohmann::json&, const char* key, const std::string& where);
std::string json_text(const nlohmann::json&, const char* key, const std::string& where);
std::string json_text_or_empty(const nlohmann::json&, const char* key, const std::string& where);
const nlohmann::json& json_list(const nlohmann::json&, const char* key, const std::string& where);
void require_schema(const nlohmann::json&, const std::string& where);

}  // namespace gpuphys
