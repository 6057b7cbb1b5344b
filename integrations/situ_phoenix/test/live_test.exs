defmodule Situ.Phoenix.LiveTest do
  # Panels and subscriptions in LiveViews, with the stock test client.
  use ExUnit.Case, async: false
  import Phoenix.ConnTest
  import Phoenix.LiveViewTest
  alias Situ.Phoenix.TestApp
  @endpoint TestApp.Bandit
  @moduletag :capture_log

  defmodule Page do
    use Phoenix.LiveView
    import Situ.Phoenix.Components

    def mount(_params, %{"pipeline" => pipeline, "test" => test}, socket) do
      socket = assign(socket, pipeline: pipeline, test: test)

      if test,
        do: {:ok, Situ.Phoenix.subscribe(socket, {pipeline, "Count"}, every: 0)},
        else: {:ok, socket}
    end

    def handle_info({:situ, "Count", event}, socket) do
      send(socket.assigns.test, {:seen, self(), event})
      # The test decides when this process has handled the message.
      receive do: (:continue -> :ok)
      {:noreply, socket}
    end

    def render(assigns) do
      ~H"""
      <.situ_panel stream={{@pipeline, "Level"}} every={0} />
      <.situ_panel stream={{@pipeline, "Picture"}} every={0} />
      <.situ_panel id="missing" stream={{@pipeline, "Nothing"}} />
      """
    end
  end

  setup do
    TestApp.start(@endpoint)

    {:ok, image} =
      Situ.Image.new(width: 8, height: 8, format: :gray8, data: :binary.copy(<<90>>, 64))

    {:ok, pipeline} =
      Situ.Pipeline.start(fn p ->
        count = Situ.sequence(p, 1, &(&1 + 1), every: Situ.Time.ms(1), name: "Count")
        Situ.map(count, &(&1 / 2), name: "Level")
        Situ.map(count, fn _ -> image end, name: "Picture")
      end)

    on_exit(fn -> Situ.Pipeline.stop(pipeline) end)
    {:ok, pipeline: pipeline}
  end

  defp mount(pipeline, test) do
    session = %{"pipeline" => pipeline, "test" => test}
    {:ok, view, _html} = live_isolated(build_conn(), Page, session: session)
    view
  end

  defp next_event(continue_to \\ nil) do
    if continue_to, do: send(continue_to, :continue)
    assert_receive {:seen, view, event}, 30_000
    {view, event}
  end

  defp wait_for(view, pattern) do
    html = render(view)
    if html =~ pattern, do: html, else: wait_for(view, pattern)
  end

  test "a busy LiveView gets one message at a time, and then the latest", %{pipeline: pipeline} do
    mount(pipeline, self())
    {view, %Situ.Message{data: first}} = next_event()
    # One message waits already; the ones after it replace each other.
    {_, %Situ.Message{data: second}} = next_event(view)
    assert second > first
    {:message_queue_len, waiting} = Process.info(view, :message_queue_len)
    assert waiting < 20
    Situ.Pipeline.stop(pipeline)
    events = Stream.repeatedly(fn -> elem(next_event(view), 1) end)
    assert Enum.find(events, &(&1 == :ended))
  end

  test "panels show a plot, a picture and an error", %{pipeline: pipeline} do
    view = mount(pipeline, nil)
    assert wait_for(view, ~r/<svg.*stroke="#4ea1f3"/s) =~ "Level"
    assert wait_for(view, "data:image/jpeg;base64,") =~ "Picture"
    assert wait_for(view, "no stream") =~ "Nothing"
    {:ok, _} = Situ.Pipeline.stop(pipeline)
    assert wait_for(view, "the pipeline has ended") =~ "<svg"
  end
end
