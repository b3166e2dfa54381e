// Tracks, fixes and events on Leaflet's map, a grid where there is no ground.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const text = value => {
    const node = document.createElement("span");
    node.textContent = value;
    return node.innerHTML;
  };
  const map = L.map("map", {preferCanvas: true, zoomSnap: 0.25, maxZoom: 22});
  map.attributionControl.setPrefix("Leaflet");
  L.control.scale({imperial: false}).addTo(map);

  // ---- what was driven
  const everything = L.featureGroup().addTo(map);
  for (const track of [...data.tracks].reverse()) {
    for (const piece of track.pieces) {
      const told = row => {
        const speed = piece.speed[row];
        const moving = speed === null ? "" : `<br>${speed.toFixed(2)} m/s (${(3.6 * speed).toFixed(1)} km/h)`;
        return `${text(track.name)}<br>${piece.time[row]}${moving}`;
      };
      const row = at => {
        let best = 0, least = Infinity;
        piece.place.forEach((place, number) => {
          const off = map.latLngToLayerPoint(place).distanceTo(map.latLngToLayerPoint(at));
          if (off < least) [best, least] = [number, off];
        });
        return best;
      };
      const add = layer => layer.addTo(everything).bindTooltip("", {sticky: true});
      if (track.dots || piece.place.length === 1) {
        piece.place.forEach((place, number) => add(
          L.circleMarker(place, {radius: 3, weight: 1, color: track.color, fillOpacity: 0.8})
        ).setTooltipContent(told(number)));
      } else {
        const line = add(L.polyline(piece.place, {color: track.color, weight: 4, smoothFactor: 0.5}));
        line.on("mousemove", event => line.setTooltipContent(told(row(event.latlng))));
      }
    }
  }
  for (const mark of [...data.marks].sort((a, b) => (a.kind === "crash") - (b.kind === "crash"))) {  // crashes on top
    const facts = Object.entries(mark).filter(([key]) => !["kind", "place", "color"].includes(key));
    const lines = facts.map(([key, value]) => `<br>${text(key)}: ${text(value)}`).join("");
    L.circleMarker(mark.place, {radius: 7, weight: 3, color: mark.color, fillColor: "#fff", fillOpacity: 0.9})
      .addTo(everything).bindTooltip(`<b>${text(mark.kind)}</b>${lines}`);
  }
  const above = {direction: "top", offset: [0, -6]}, below = {direction: "bottom", offset: [0, 6]};
  const first = data.tracks[0].pieces[0].place[0], last = data.tracks[0].pieces.at(-1).place.at(-1);
  for (const [place, name] of [[first, "start"], [last, "end"]]) {
    L.circleMarker(place, {radius: 5, weight: 2, color: "#1a1a1a", fillColor: "#fff", fillOpacity: 1})
      .addTo(everything).bindTooltip(name, {permanent: true, ...(name === "start" ? above : below)});
  }
  map.fitBounds(everything.getBounds(), {maxZoom: 19, paddingTopLeft: [40, 150], paddingBottomRight: [40, 50]});

  // ---- the ground
  const served = location.protocol.startsWith("http");
  const ground = data.tiles || (served ? "https://tile.openstreetmap.org/{z}/{x}/{y}.png" : "");
  const owner = data.tiles ? data.attribution
    : '&copy; <a href="https://www.openstreetmap.org/copyright">OpenStreetMap</a> contributors';
  const grid = L.layerGroup().addTo(map);
  const metre = () => {  // degrees of latitude and longitude in a metre
    const middle = map.getCenter().lat * Math.PI / 180;
    return [180 / (Math.PI * 6378137), 180 / (Math.PI * 6378137 * Math.max(Math.cos(middle), 1e-3))];
  };
  const rule = () => {
    grid.clearLayers();
    const bounds = map.getBounds().pad(0.5), [lat1, lon1] = metre();
    const wide = (bounds.getEast() - bounds.getWest()) / 2 / lon1;
    const size = 10 ** Math.floor(Math.log10(wide / 12)), step = [1, 2, 5, 10].map(n => n * size).find(n => wide / n <= 12);
    const style = {color: "#d0d4d8", weight: 1, interactive: false};
    const lines = (from, to, width, draw) => {
      for (let n = Math.ceil((from - draw.zero) / width); draw.zero + n * width <= to; n++) draw(draw.zero + n * width);
    };
    const up = lon => L.polyline([[bounds.getSouth(), lon], [bounds.getNorth(), lon]], style).addTo(grid);
    const across = lat => L.polyline([[lat, bounds.getWest()], [lat, bounds.getEast()]], style).addTo(grid);
    [across.zero, up.zero] = first;
    lines(bounds.getWest(), bounds.getEast(), step * lon1, up);
    lines(bounds.getSouth(), bounds.getNorth(), step * lat1, across);
    grid.eachLayer(line => line.bringToBack());
    note(`no street map: grid of ${step >= 1000 ? step / 1000 + " km" : step + " m"} from the start${served ? ""
      : "; for one, serve this folder: python -m http.server --bind 127.0.0.1"}`);
  };

  const about = L.control({position: "topright"});
  const names = data.tracks.map(track =>
    `<i class="${track.dots ? "dots" : ""}" style="border-color:${track.color}"></i>${text(track.name)}<br>`).join("");
  const kinds = [...new Map(data.marks.map(mark => [mark.kind, mark.color]))].map(([kind, color]) =>
    `<i class="ring" style="border-color:${color}"></i>${text(kind)}<br>`).join("");
  about.onAdd = () => {
    const box = L.DomUtil.create("div", "about");
    box.innerHTML = `<b>${text(data.name)}</b>${names}${kinds}<p class="ground"></p>`;
    box.title = data.note;
    return box;
  };
  about.addTo(map);
  const note = told => document.querySelector(".ground").textContent = told;
  map.on("moveend", rule);
  rule();
  if (ground) {
    const tiles = L.tileLayer(ground, {
      attribution: owner, maxZoom: 22, maxNativeZoom: 19, referrerPolicy: "strict-origin-when-cross-origin",
    }).addTo(map);
    tiles.once("tileload", () => {
      map.off("moveend", rule);
      grid.clearLayers();
      note("");
    });
  }
  document.documentElement.dataset.ready = "1";
})();
