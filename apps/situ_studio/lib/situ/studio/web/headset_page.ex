defmodule Situ.Studio.Web.HeadsetPage do
  @moduledoc false
  # The page that is a headset: it needs no view on the server, only its script.
  alias Situ.Live.{Request, Response}
  alias Situ.Studio.Web.StaticPage

  @body """
  <h1>This page is a headset</h1>
  <p>Open it in the browser of a headset. While its session runs it sends head, hands and gaze to the pipeline that
     waits for them, and draws what the pipeline shows.</p>
  <p><button class="btn" id="start" type="button">Enter</button>
     <button class="btn" id="stop" type="button" hidden>Leave</button></p>
  <p id="status" role="status">Not started.</p>
  """

  @spec call(Request.t(), {studio :: String.t(), base :: String.t()}) :: Response.t()
  def call(%Request{}, {_studio, base}),
    do: StaticPage.response(base, title: "Headset", script: "headset.js", body: @body)
end
