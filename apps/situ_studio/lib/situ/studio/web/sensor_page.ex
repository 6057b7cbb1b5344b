defmodule Situ.Studio.Web.SensorPage do
  @moduledoc false
  # The page that is a camera and a microphone: it needs no view on the server, only its script.
  alias Situ.Live.{Request, Response}

  @csp "default-src 'self'; connect-src 'self' ws: wss:; media-src 'self' blob:; frame-ancestors 'none'"

  @html """
  <!doctype html>
  <html lang="en">
    <head>
      <meta charset="utf-8">
      <meta name="viewport" content="width=device-width, initial-scale=1">
      <base href="{base}">
      <title>{title} - Situ Studio</title>
      <link rel="icon" href="assets/favicon.svg">
      <link rel="stylesheet" href="assets/studio.css">
      <script src="assets/theme.js"></script>
      <script type="module" src="assets/{script}"></script>
    </head>
    <body>
      <main class="message">
        {body}
      </main>
    </body>
  </html>
  """

  @body """
  <h1>This page is a sensor</h1>
  <p>While it is open it sends its camera and microphone to the pipeline that waits for them.</p>
  <p><label>Camera <select id="camera"></select></label>
     <label>Microphone <select id="microphone"></select></label></p>
  <p><button class="btn" id="start" type="button">Start</button>
     <button class="btn" id="stop" type="button" hidden>Stop</button></p>
  <p id="status" role="status">Not started.</p>
  <video id="preview" muted playsinline width="480"></video>
  """

  @spec call(Request.t(), {studio :: String.t(), base :: String.t()}) :: Response.t()
  def call(%Request{}, {_studio, base}),
    do: page(base, title: "Sensor", script: "sensor.js", body: @body)

  @doc "The page with this title, script and body."
  @spec page(String.t(), keyword()) :: Response.t()
  # a base holds no character that HTML knows (`Situ.Live.Public`)
  def page(base, parts),
    do:
      [{:base, base} | parts]
      |> Enum.reduce(@html, fn {name, text}, html -> String.replace(html, "{#{name}}", text) end)
      |> Response.html()
      |> Response.put_header("content-security-policy", @csp)
end
