defmodule Situ.Studio.Web.SensorPage do
  @moduledoc false
  # Serves the page that acts as a camera and a microphone. It has no view on the server, only a script.
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.Web.StaticPage

  @body """
  <h1>This page is a sensor</h1>
  <p>While this page is open, it sends camera images and microphone audio to the connected pipeline.</p>
  <p><label>Camera <select id="camera"></select></label>
     <label>Microphone <select id="microphone"></select></label></p>
  <p><button class="btn" id="start" type="button">Start</button>
     <button class="btn" id="stop" type="button" hidden>Stop</button></p>
  <p id="status" role="status">Not started.</p>
  <p id="recording" hidden>It is recorded until this page is closed. <a target="_blank">Open the recording</a></p>
  <video id="preview" muted playsinline width="480"></video>
  """

  @spec call(Request.t(), {studio :: String.t(), base :: String.t()}) :: Response.t()
  def call(%Request{}, {_studio, base}),
    do: StaticPage.build_response(base, title: "Sensor", script: "sensor.js", body: @body)
end
