defmodule Situ.Live.BrowserTest do
  # Runs the stock JavaScript clients in Chromium with the demo view.
  use ExUnit.Case, async: false
  alias Situ.Live.{Demo, NodeTools}

  @moduletag :browser
  @moduletag timeout: 120_000

  test "the stock clients drive a view: events, forms, lists, streams, navigation, crash" do
    bundle = NodeTools.bundle!()

    routes = [
      {:live, "/", Demo.Main, session: %{"user" => "ann"}},
      {:live, "/other", Demo.Other},
      {:static, "/", bundle}
    ]

    server = start_supervised!({Situ.Live, port: 0, routes: routes})
    url = String.trim_trailing(Situ.Live.url(server), "/")

    {output, status} =
      ExUnit.CaptureLog.with_log(fn ->
        NodeTools.run("test/browser.mjs", [url], env: [{"CHROMIUM", NodeTools.chromium()}])
      end)
      |> elem(0)

    assert status == 0, output
    refute output =~ "FAIL"
    assert output =~ "ok   push_navigate"
  end
end
