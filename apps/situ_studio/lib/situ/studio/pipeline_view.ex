defmodule Situ.Studio.PipelineView do
  @moduledoc false
  # Serves the page of a pipeline's graph. It shows components, composites that can be folded, and
  # connections with their policies, coloured by any statistic of
  # `Situ.Studio.PipelineView.Stats`. A click shows an object's statistics on the right, with
  # plots of their history.
  #
  # For a running pipeline the page shows the current state, updated twice a second, and the hour
  # before the page was opened. For a recording it shows the moment chosen below the graph. The
  # address contains the view: `heat`, `mark`, `way`, `fold`, `sel`, `plots`, `at`.
  use Situ.Live.View

  alias Situ.Studio.{Alerts, Catalog}

  alias Situ.Studio.PipelineView.{
    AddressParams,
    Details,
    Feed,
    FoldedGraph,
    Page,
    History,
    Stats,
    Tracing,
    Wire
  }

  @tick_ms 500
  # The number of samples kept for the plots; an open page adds 1,200 samples in ten minutes.
  @kept 1_200
  @recorded 400
  @messages 8

  @impl true
  def mount(params, session, socket) do
    studio = session["studio"]
    id = params["id"] |> List.wrap() |> Enum.join("/")

    socket =
      assign(socket,
        studio: studio,
        id: id,
        page_title: "#{id} pipeline - Situ Studio",
        error: nil,
        heat: "queue",
        mark: "none",
        way: "LR",
        folded: MapSet.new(),
        selected: nil,
        plots: [],
        at: nil,
        moments: [],
        snapshot: nil,
        taken: nil,
        sample: %{at: 0, edges: %{}, nodes: %{}},
        samples: [],
        messages: [],
        live: false,
        drawn: nil,
        trace: nil,
        untraced: nil,
        alerts: []
      )

    with {:ok, item, source} <- Catalog.open_source(studio, id),
         {:ok, feed} <- Feed.open(source),
         {:ok, snapshot, taken} <- Feed.fetch_latest(feed) do
      {:ok, start_view(assign(socket, item: item, feed: feed), feed, snapshot, taken)}
    else
      {:error, error} -> {:ok, assign(socket, error: error)}
    end
  end

  defp start_view(socket, {:live, _}, snapshot, taken) do
    past =
      if connected?(socket) do
        Process.send_after(self(), :tick, @tick_ms)
        History.list_samples(socket.assigns.studio, socket.assigns.item.id)
      else
        []
      end

    socket
    |> assign(live: true, folded: FoldedGraph.default_folded(snapshot), samples: past)
    |> observe_snapshot(snapshot, taken)
  end

  defp start_view(socket, {:recorded, _, _} = feed, snapshot, taken) do
    if connected?(socket), do: send(self(), {:past, Feed.list_times(feed, @recorded), nil})

    socket
    |> assign(folded: FoldedGraph.default_folded(snapshot), at: taken)
    |> observe_snapshot(snapshot, taken)
    |> assign(samples: [])
  end

  # The following functions handle the address.

  @impl true
  def handle_params(_params, _uri, %{assigns: %{error: %{}}} = socket), do: {:noreply, socket}

  def handle_params(params, _uri, socket) do
    socket = assign(socket, AddressParams.parse_params(params, socket.assigns.snapshot.scopes))
    {:noreply, socket |> show_moment(params["at"]) |> load_messages() |> push_graph()}
  end

  # Shows the requested moment of a recording.
  defp show_moment(%{assigns: %{live: false}} = socket, text) when is_binary(text) do
    with {time, ""} <- Integer.parse(text),
         {:ok, snapshot, taken} <- Feed.fetch_at(socket.assigns.feed, time) do
      socket |> assign(at: taken) |> observe_snapshot(snapshot, taken)
    else
      _ -> socket
    end
  end

  defp show_moment(socket, _), do: socket

  defp patch_address(socket, changes),
    do:
      push_patch(socket, to: AddressParams.build_address(socket.assigns, changes), replace: true)

  # The following clauses handle events from the page.

  @impl true
  def handle_event(_, _, %{assigns: %{error: %{}}} = socket), do: {:noreply, socket}

  def handle_event("ready", _, socket),
    do: {:noreply, socket |> assign(drawn: nil) |> push_graph() |> push_series()}

  def handle_event("heat", %{"heat" => id}, socket),
    do: {:noreply, patch_address(socket, %{"heat" => id})}

  def handle_event("mark", %{"mark" => mark, "way" => way}, socket),
    do: {:noreply, patch_address(socket, %{"mark" => mark, "way" => way})}

  def handle_event("pick", %{"key" => key}, socket) when is_binary(key) do
    key = if key == socket.assigns.selected, do: nil, else: key
    {:noreply, patch_address(socket, %{"sel" => key})}
  end

  def handle_event("fold", %{"path" => path}, socket) when is_binary(path) do
    {:noreply,
     patch_address(socket, %{"fold" => AddressParams.toggle_fold(socket.assigns.folded, path)})}
  end

  def handle_event("fold_all", _, socket),
    do:
      {:noreply,
       patch_address(socket, %{
         "fold" => AddressParams.encode_folds(socket.assigns.snapshot.scopes)
       })}

  def handle_event("unfold_all", _, socket),
    do: {:noreply, patch_address(socket, %{"fold" => ""})}

  def handle_event("plot", %{"stat" => id}, socket) do
    shown = Details.plotted_stats(socket.assigns)
    plots = if id in shown, do: shown -- [id], else: shown ++ [id]
    {:noreply, patch_address(socket, %{"plots" => Enum.join(plots, ",")})}
  end

  def handle_event("trace", %{"time" => time}, socket) do
    case Tracing.trace_text(socket.assigns.feed, time, socket.assigns.taken) do
      {:ok, trace} -> {:noreply, assign(socket, trace: trace, untraced: nil)}
      {:error, error} -> {:noreply, assign(socket, trace: nil, untraced: error)}
    end
  end

  def handle_event("trace_close", _, socket), do: {:noreply, assign(socket, trace: nil)}

  def handle_event("at", %{"moment" => index}, socket) do
    with {i, ""} <- Integer.parse(to_string(index)),
         time when is_integer(time) <- Enum.at(socket.assigns.moments, i) do
      {:noreply, patch_address(socket, %{"at" => time})}
    else
      _ -> {:noreply, socket}
    end
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  # The following clauses handle updates.

  @impl true
  def handle_info(:tick, socket) do
    case Feed.fetch_latest(socket.assigns.feed) do
      {:ok, snapshot, taken} ->
        Process.send_after(self(), :tick, @tick_ms)
        a = socket.assigns
        alerts = Alerts.list_alerts(a.studio, a.item.id)
        socket = assign(socket, trace: Tracing.update_trace(a.feed, a.trace), alerts: alerts)

        {:noreply,
         socket
         |> observe_snapshot(snapshot, taken)
         |> load_messages()
         |> push_graph()
         |> push_point()}

      # The pipeline has ended. The page keeps showing its last state.
      {:error, _} ->
        {:noreply, assign(socket, live: false)}
    end
  end

  # A recording's history is read in steps, so that the page stays responsive.
  def handle_info({:past, [], _}, socket), do: {:noreply, push_series(socket)}

  def handle_info({:past, times, earlier}, socket) do
    {now, later} = Enum.split(times, 20)

    {samples, earlier} =
      Enum.flat_map_reduce(now, earlier, fn time, earlier ->
        case Feed.fetch_at(socket.assigns.feed, time) do
          {:ok, snapshot, taken} ->
            {[Stats.compute_sample(snapshot, taken, earlier)], {snapshot, taken}}

          {:error, _} ->
            {[], earlier}
        end
      end)

    send(self(), {:past, later, earlier})
    a = socket.assigns

    {:noreply,
     assign(socket,
       samples: Enum.reverse(samples) ++ a.samples,
       moments: a.moments ++ Enum.map(samples, & &1.at)
     )}
  end

  def handle_info(_, socket), do: {:noreply, socket}

  defp observe_snapshot(socket, snapshot, taken) do
    a = socket.assigns
    earlier = earlier_snapshot(a, taken)
    sample = Stats.compute_sample(snapshot, taken, earlier)

    assign(socket,
      snapshot: snapshot,
      taken: taken,
      sample: sample,
      samples: if(a.live, do: Enum.take([sample | a.samples], @kept), else: a.samples)
    )
  end

  defp earlier_snapshot(%{snapshot: nil}, _), do: nil
  defp earlier_snapshot(%{live: true} = a, _taken), do: {a.snapshot, a.taken}

  # Fetches the recorded snapshot before this one.
  defp earlier_snapshot(a, taken) do
    case Feed.fetch_at(a.feed, taken - 1) do
      {:ok, snapshot, time} -> {snapshot, time}
      _ -> nil
    end
  end

  # Loads the last messages of the selected connection.
  defp load_messages(socket) do
    a = socket.assigns

    case Details.selected_stream(a.snapshot, a.selected) do
      nil ->
        assign(socket, messages: [])

      stream ->
        time = if a.live, do: :now, else: a.taken
        assign(socket, messages: Feed.list_messages(a.feed, stream, time, @messages))
    end
  end

  # The following functions push events to the page's hooks.

  defp push_graph(socket) do
    a = socket.assigns
    graph = FoldedGraph.fold_graph(a.snapshot, a.folded)
    shape = :erlang.phash2({graph, a.way})

    socket =
      if a.drawn == shape,
        do: socket,
        else: push_event(socket, "pipeline:graph", Wire.graph_message(graph, a.way))

    socket
    |> assign(drawn: shape)
    |> push_event(
      "pipeline:stats",
      Wire.stats_message(graph, a.snapshot, a.sample, {a.heat, a.mark}, a.selected)
    )
  end

  defp push_point(socket) do
    a = socket.assigns

    push_event(
      socket,
      "pipeline:point",
      Wire.point_message(a.sample, a.selected, a.folded, a.snapshot, Details.plotted_stats(a))
    )
  end

  defp push_series(socket) do
    a = socket.assigns
    samples = Enum.reverse(a.samples)

    push_event(
      socket,
      "pipeline:series",
      Wire.series_message(samples, a.selected, a.folded, a.snapshot, Details.plotted_stats(a))
    )
  end

  @impl true
  def render(assigns), do: Page.render(assigns)
end
