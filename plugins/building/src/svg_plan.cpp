// The drawing of one level: what does not depend on tracks.

#include "svg_plan.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace fiona::building {
namespace {

std::string ring_path(const View& view, const Polygon& polygon) {
  std::string d;
  const auto add = [&](const Ring& ring) {
    for (std::size_t i = 0; i < ring.size(); ++i) d += (i == 0 ? "M" : "L") + view.at(ring[i]);
    d += "Z";
  };
  add(polygon.outer);
  for (const Ring& hole : polygon.holes) add(hole);
  return d;
}

const char* fill_of(const Room& room) {
  switch (room.kind) {
    case RoomKind::Corridor: return "#ffffff";
    case RoomKind::Area: return "#fbf8ef";
    case RoomKind::Stairs: return "url(#steps)";
    case RoomKind::Lift: return "#dfe3ea";
    case RoomKind::Room: break;
  }
  return room.use == "toilets" ? "#e6f0f4" : "#eef1f5";
}

/// Breaks a name at its spaces into lines that fit; nothing if it does not fit at the smallest size.
std::vector<std::string> lines_that_fit(const std::string& name, double width_px, double font_px) {
  std::vector<std::string> lines{""};
  const auto fits = [&](const std::string& text) {
    return 0.56 * font_px * static_cast<double>(text.size()) < width_px;
  };
  for (std::size_t from = 0; from < name.size();) {
    const std::size_t end = std::min(name.find(' ', from), name.size());
    const std::string word = name.substr(from, end - from);
    if (!fits(word)) return {};
    const std::string joined = lines.back().empty() ? word : lines.back() + " " + word;
    if (fits(joined))
      lines.back() = joined;
    else
      lines.push_back(word);
    from = end + 1;
  }
  return lines;
}

/// Width and height of the free space around the label, along the axes.
Point room_for_label(const Room& room) {
  const std::vector<Segment> sides = edges(room.polygon);
  const auto reach = [&](Point direction) {
    double nearest = 1.0;
    for (const Segment& side : sides) {
      if (const auto at = crossing({room.centre, room.centre + direction}, side)) nearest = std::min(nearest, *at);
    }
    return nearest * length_m(direction);
  };
  return {2 * std::min(reach({500, 0}), reach({-500, 0})), 2 * std::min(reach({0, 500}), reach({0, -500}))};
}

std::string label(const View& view, const Room& room) {
  const std::string& name = room.name.empty() ? room.ref : room.name;
  if (name.empty() || room.kind == RoomKind::Lift) return {};  // a lift has its sign
  const Point space = room_for_label(room) * view.scale;
  for (double font_px : {12.0, 10.0, 8.5}) {
    const auto lines = lines_that_fit(name, space.x_m - 6, font_px);
    const double height = 1.2 * font_px * static_cast<double>(lines.size());
    if (lines.empty() || height > space.y_m - 4) continue;
    std::string svg;
    // Above the middle where there is space: tracks start and end in the middle of rooms.
    const double lift_px = space.y_m > 2 * height + 30 ? height / 2 + 8 : 0.0;
    double y = view.y(room.centre.y_m) - lift_px - height / 2 + font_px;
    for (const std::string& line : lines) {
      svg += "<text class=\"label\" style=\"font-size:" + number(font_px) + "px\"" +
             attribute("x", view.x(room.centre.x_m)) + attribute("y", y) + ">" + escape_xml(line) + "</text>\n";
      y += 1.2 * font_px;
    }
    return svg;
  }
  return {};
}

/// `edged`: nothing else shows where the room ends.
std::string draw_room(const View& view, const Room& room, bool edged) {
  const std::string name = room.name.empty() ? (room.ref.empty() ? text(room.id) : room.ref) : room.name;
  return "<path fill-rule=\"evenodd\" fill=\"" + std::string(fill_of(room)) + "\"" +
         (edged ? " stroke=\"#9aa5b1\" stroke-width=\"0.8\"" : "") + " d=\"" + ring_path(view, room.polygon) +
         "\"><title>" + escape_xml(name) + "</title></path>\n";
}

/// An arrow outside of the door that points inwards.
std::string draw_entrance(const View& view, const Plan& plan, const Door& door) {
  const bool normal_leads_in = room_index_at(plan, door.at + door.normal * 0.5, door.level).has_value();
  const Point inwards = normal_leads_in ? door.normal : door.normal * -1.0;
  const double unit_m = 9.0 / view.scale;
  const Point tip = door.at - inwards * (0.3 * unit_m);
  const Point base = tip - inwards * unit_m;
  const Point wing = left_of(inwards) * (0.6 * unit_m);
  return "<path fill=\"#1f2933\" d=\"M" + view.at(tip) + "L" + view.at(base + wing) + "L" + view.at(base - wing) +
         "Z\"><title>" + escape_xml(door.name.empty() ? "entrance" : door.name) + "</title></path>\n";
}

std::string draw_door(const View& view, const Plan& plan, const Door& door) {
  const Point half = left_of(door.normal) * (door.width_m / 2);
  std::string svg = draw_line(view, "door", {door.at - half, door.at + half});
  if (door.entrance) svg += draw_entrance(view, plan, door);
  return svg;
}

std::string draw_connector(const View& view, const Connector& connector, double level) {
  if (std::find(connector.levels.begin(), connector.levels.end(), level) == connector.levels.end()) return {};
  if (connector.kind == ConnectorKind::Lift) {
    const Point at = connector.path.front().at;
    const double half = std::clamp(0.7 * view.scale, 4.0, 11.0);
    const double x = view.x(at.x_m), y = view.y(at.y_m);
    return "<g class=\"lift\"><title>lift</title><rect" + attribute("x", x - half) + attribute("y", y - half) +
           attribute("width", 2 * half) + attribute("height", 2 * half) + "/><path d=\"M" + number(x - half) + "," +
           number(y - half) + "l" + number(2 * half) + "," + number(2 * half) + "M" + number(x + half) + "," +
           number(y - half) + "l" + number(-2 * half) + "," + number(2 * half) + "\"/></g>\n";
  }
  std::string svg = "<polyline class=\"stairs\" points=\"";
  for (const PathPoint& p : connector.path) svg += view.at(p.at) + " ";
  return svg + "\"><title>stairs</title></polyline>\n";
}

/// Large rooms first: what lies within another room must stay visible.
std::vector<const Room*> rooms_on(const Plan& plan, double level) {
  std::vector<const Room*> rooms;
  for (const Room& room : plan.rooms) {
    if (room.level == level) rooms.push_back(&room);
  }
  std::stable_sort(rooms.begin(), rooms.end(),
                   [](const Room* a, const Room* b) { return area_m2(a->polygon) > area_m2(b->polygon); });
  return rooms;
}

std::string draw_path(const View& view, const Path& path) {
  std::string svg;
  for (std::size_t i = 1; i < path.points.size(); ++i) {
    svg += draw_line(view, "path", {path.points[i - 1].at, path.points[i].at});
  }
  return svg;
}

}  // namespace

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.2f", value);
  return text;
}

std::string attribute(const char* name, double value) { return std::string(" ") + name + "=\"" + number(value) + "\""; }

std::string View::at(Point p) const { return number(x(p.x_m)) + "," + number(y(p.y_m)); }

std::string draw_line(const View& view, const char* kind, const Segment& segment) {
  return "<line class=\"" + std::string(kind) + "\"" + attribute("x1", view.x(segment.from.x_m)) +
         attribute("y1", view.y(segment.from.y_m)) + attribute("x2", view.x(segment.to.x_m)) +
         attribute("y2", view.y(segment.to.y_m)) + "/>\n";
}

std::string draw_plan(const View& view, const Plan& plan, double level) {
  std::string svg;
  if (!plan.outline.outer.empty()) svg += "<path fill=\"#fafbfc\" d=\"" + ring_path(view, plan.outline) + "\"/>\n";
  for (const Room* room : rooms_on(plan, level)) svg += draw_room(view, *room, plan.walls.empty());
  for (const Path& path : plan.paths) {
    if (path.points.front().level == level) svg += draw_path(view, path);
  }
  for (const Connector& connector : plan.connectors) svg += draw_connector(view, connector, level);
  for (const Wall& wall : plan.walls) {
    if (wall.level == level) svg += draw_line(view, wall.exterior ? "outer" : "wall", wall.segment);
  }
  for (const Door& door : plan.doors) {
    if (door.level == level) svg += draw_door(view, plan, door);
  }
  return svg;
}

std::string draw_names(const View& view, const Plan& plan, double level) {
  std::string svg;
  const auto known =
      std::find_if(plan.levels.begin(), plan.levels.end(), [&](const Level& other) { return other.level == level; });
  for (const Room* room : rooms_on(plan, level)) {
    // The panel's heading says it already.
    if (known == plan.levels.end() || room->name != known->name) svg += label(view, *room);
  }
  return svg;
}

}  // namespace fiona::building
