(function () {
  "use strict";
  var dark = window.matchMedia("(prefers-color-scheme: dark)");
  var charts = [];

  function token(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  // Colours of paper, ink and grid follow the style sheet, so that charts and text always match.
  function template() {
    var clear = "rgba(0,0,0,0)";
    var axis = {
      gridcolor: token("--line"), linecolor: token("--rule"), tickcolor: token("--rule"),
      zerolinecolor: token("--line"), automargin: true
    };
    var solid = Object.assign({ showbackground: false }, axis);
    return {
      layout: {
        font: { color: token("--ink"), family: token("--sans"), size: 13 },
        paper_bgcolor: clear, plot_bgcolor: clear,
        xaxis: axis, yaxis: axis, scene: { xaxis: solid, yaxis: solid, zaxis: solid },
        legend: { bgcolor: clear },
        modebar: { bgcolor: clear, color: token("--rule"), activecolor: token("--accent") },
        hoverlabel: { bgcolor: token("--card"), bordercolor: token("--rule"), font: { color: token("--ink") } }
      }
    };
  }

  function repaint() {
    charts.forEach(function (box) { Plotly.relayout(box, { template: template() }); });
  }

  document.querySelectorAll("script[data-chart]").forEach(function (source) {
    var box = document.getElementById(source.dataset.chart);
    var spec = JSON.parse(source.textContent);
    var layout = Object.assign({}, spec.layout, { template: template() });
    if (layout.scene) {
      // A scene is fitted to its height; in a narrow box its sides are kept in view from farther off.
      var eye = layout.scene.camera.eye;
      var farther = Math.max(1, Math.min(1.5, 480 / box.clientWidth));
      ["x", "y", "z"].forEach(function (axis) { eye[axis] *= farther; });
    }
    // The buttons are named one by one, so that none that sends a chart anywhere can be among them. Scrolling is the
    // page's own.
    Plotly.newPlot(box, spec.data, layout, {
      responsive: true, displaylogo: false, scrollZoom: false, showSendToCloud: false, plotlyServerURL: "",
      displayModeBar: Boolean(spec.layout.scene), modeBarButtons: [["resetCameraDefault3d", "toImage"]]
    });
    charts.push(box);
  });

  dark.addEventListener("change", repaint);
  window.matchMedia("print").addEventListener("change", repaint);
})();
