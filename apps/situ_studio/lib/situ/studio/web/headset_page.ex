defmodule Situ.Studio.Web.HeadsetPage do
  @moduledoc false
  # Serves the page that acts as a headset. It has no view on the server, only a script.
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.Web.StaticPage

  @body """
  <h1>This page is a headset</h1>
  <p>Open it in the browser of a headset. During a session, it sends head, hand and gaze poses to the connected
     pipeline, and renders the scenes that the pipeline sends back.</p>
  <p><button class="btn" id="start" type="button">Enter</button>
     <button class="btn" id="stop" type="button" hidden>Leave</button></p>
  <p id="status" role="status">Not started.</p>
  """

  @spec call(Request.t(), {studio :: String.t(), base :: String.t()}) :: Response.t()
  def call(%Request{}, {_studio, base}),
    do: StaticPage.build_response(base, title: "Headset", script: "headset.js", body: @body)
end
