defmodule Situ.Studio.PipelineView.Details do
  @moduledoc false
  # Renders the right sidebar: text, statistics, plots and the last messages of the selection. Without a selection it
  # lists waiting producers and the highest values.
  use Situ.Live.Component
  alias Situ.Studio.PipelineView.{Stats, Waits, Wire}

  @edge_plots ["queue", "processed_rate", "latency_mean"]
  @node_plots ["mailbox", "memory", "reductions_rate"]

  @doc "Returns the statistics to plot: the chosen ones that fit the selection, or a few defaults."
  @spec plotted_stats(map()) :: [String.t()]
  def plotted_stats(%{selected: selected, plots: chosen}) do
    {kind, few} =
      case selected do
        "e" <> _ -> {:edge, @edge_plots}
        key when is_binary(key) -> {:node, @node_plots}
        nil -> {nil, []}
      end

    case Enum.filter(chosen, &match?({:ok, %{of: ^kind}}, Stats.fetch(&1))) do
      [] -> few
      fitting -> fitting
    end
  end

  @doc "Returns the stream whose messages are sent over the selected connection."
  @spec selected_stream(Situ.Diagnostics.Snapshot.t(), String.t() | nil) :: String.t() | nil
  def selected_stream(snapshot, "e" <> _ = key) do
    {:edges, ids} = Wire.resolve_selection(key, MapSet.new(), snapshot)

    with [id | _] <- ids,
         %{from: from, from_output: output} <- Enum.find(snapshot.edges, &(&1.id == id)),
         %{outputs: outputs} <- Enum.find(snapshot.nodes, &(&1.id == from)),
         %{stream: stream} <- Enum.find(outputs, &(&1.name == output)) do
      stream
    else
      _ -> nil
    end
  end

  def selected_stream(_, _), do: nil

  attr(:snapshot, :any, required: true)
  attr(:sample, :map, required: true)
  attr(:selected, :string, default: nil)
  attr(:folded, :any, required: true)
  attr(:messages, :list, required: true)
  attr(:heat, :string, required: true)
  attr(:plots, :list, required: true)
  attr(:live, :boolean, default: false)

  @doc false
  def details_panel(assigns) do
    {kind, ids} = Wire.resolve_selection(assigns.selected, assigns.folded, assigns.snapshot)

    case {kind, ids} do
      {:edges, ids} -> edge_details(assigns, Enum.filter(assigns.snapshot.edges, &(&1.id in ids)))
      {:nodes, ids} -> node_details(assigns, Enum.filter(assigns.snapshot.nodes, &(&1.id in ids)))
      _ -> pipeline_overview(assigns)
    end
  end

  defp pipeline_overview(assigns) do
    waits = Waits.list_waits(assigns.snapshot, assigns.sample)
    assigns = assign(assigns, rows: highest_values(assigns), waits: waits)

    ~H"""
    <div class="side-title">Pipeline</div>
    <div class="props">
      <h2>{@snapshot.pipeline}</h2>
        <p class="hint">Click a component or a connection to see its statistics.</p>
      <div :if={@waits != []} class="worst waits">
        <h3>Who waits for whom</h3>
        <button :for={w <- @waits} class="row-button" type="button" phx-click="pick" phx-value-key={"e#{w.edge}"}
            ><span><b>{w.who}</b> waits for <b>{w.input}</b>, {w.queue} in its queue: {w.why}</span></button>
      </div>
      <div :if={@rows != []} class="worst">
        <h3>{heat_heading(@heat)}</h3>
        <button :for={{key, name, text} <- @rows} class="row-button" type="button" phx-click="pick"
            phx-value-key={key}><span>{name}</span><b>{text}</b></button>
      </div>
    </div>
    """
  end

  defp heat_heading(heat) do
    case Stats.fetch(heat) do
      {:ok, %{name: name}} -> name
      :error -> ""
    end
  end

  # Lists the objects with the highest values of the statistic that the graph is coloured by.
  defp highest_values(%{heat: heat, snapshot: snapshot, sample: sample}) do
    paths = Map.new(snapshot.nodes, &{&1.id, &1.path})

    rows =
      case Stats.fetch(heat) do
        {:ok, %{of: :edge}} ->
          for e <- snapshot.edges, e.kind == :process, v = sample.edges[e.id][heat] do
            {v, "e#{e.id}", "#{paths[e.from]} → #{paths[e.to]}"}
          end

        {:ok, %{of: :node}} ->
          for n <- snapshot.nodes, v = sample.nodes[n.id][heat], do: {v, "n#{n.id}", n.path}

        :error ->
          []
      end

    rows
    |> Enum.filter(fn {v, _, _} -> v > 0 end)
    |> Enum.sort_by(&elem(&1, 0), :desc)
    |> Enum.take(12)
    |> Enum.map(fn {v, key, name} -> {key, name, Stats.format_value(heat, v)} end)
  end

  defp edge_details(assigns, []), do: removed_message(assigns)

  defp edge_details(assigns, [first | _] = edges) do
    paths = Map.new(assigns.snapshot.nodes, &{&1.id, &1.path})
    values = edges |> Enum.map(&(assigns.sample.edges[&1.id] || %{})) |> Stats.merge_values()

    assigns =
      assign(assigns,
        edges: edges,
        waits: edge_waits(assigns, edges),
        paths: paths,
        values: values,
        first: first,
        stats: Stats.list_stats(:edge),
        shown: plotted_stats(assigns)
      )

    ~H"""
    <div class="side-title">Connection</div>
    <div class="props">
      <div :for={e <- @edges} class="ends">
        <h2>{@paths[e.from]} → {@paths[e.to]}</h2>
        <p
            class="sub">{e.from_output} → {e.to_input}, {e.policy}{if e.kind == :inline, do: ", inside one process"}</p>
      </div>
      <p :for={w <- @waits} class="wait">{w.who} waits for {w.input}: {w.why}.</p>
      <h3>Last messages</h3>
      <p :if={@messages == []} class="hint">No message has arrived yet, or none was kept.</p>
      <ol class="messages">
        <li :for={m <- @messages} :key={m.originating_time} id={"at-#{m.originating_time}"}><button
            :if={@live} type="button" class="linkish"
            phx-click="trace" phx-value-time={m.originating_time} title="Where is this time in the pipeline?"
            ><time>{format_clock(m.originating_time)}</time></button><time
            :if={not @live}>{format_clock(m.originating_time)}</time
            ><code>{inspect_short(m.data)}</code></li>
      </ol>
      <h3>Numbers</h3>
      <.stats_table stats={@stats} values={@values} shown={@shown} />
      <.stat_charts shown={@shown} selected={@selected} />
    </div>
    """
  end

  defp edge_waits(%{snapshot: snapshot, sample: sample}, edges) do
    ids = Enum.map(edges, & &1.id)
    snapshot |> Waits.list_waits(sample) |> Enum.filter(&(&1.edge in ids))
  end

  defp node_details(assigns, []), do: removed_message(assigns)

  defp node_details(assigns, nodes) do
    numbers = nodes |> Enum.map(& &1.process) |> Enum.uniq()
    values = nodes |> Enum.map(&(assigns.sample.nodes[&1.id] || %{})) |> Stats.merge_values()

    assigns =
      assign(assigns,
        nodes: nodes,
        scope: match?("s:" <> _, assigns.selected),
        values: values,
        stats: Stats.list_stats(:node),
        shown: plotted_stats(assigns),
        processes: Enum.filter(assigns.snapshot.processes, &(&1.number in numbers))
      )

    ~H"""
    <div class="side-title">{if @scope, do: "Composite", else: "Component"}</div>
    <div class="props">
      <h2 :if={@scope}>{String.replace_prefix(@selected, "s:", "")}</h2>
      <p :if={@scope} class="sub">{length(@nodes)} components in {length(@processes)} processes</p>
      <div :for={n <- Enum.take(@nodes, 12)} class={if @scope, do: "member"}>
        <h2>{n.path}</h2>
        <p class="sub">{describe_node(n)}, {n.state}</p>
        <p :if={n.description} class="state-text">{n.description}</p>
        <dl :if={not @scope}>
          <dt :for={p <- n.inputs}>in {p.name}</dt>
          <dd :for={p <- n.inputs}>{p.type}</dd>
          <dt :for={p <- n.outputs}>out {p.name}</dt>
          <dd :for={p <- n.outputs} title={p.stream}>{p.type}</dd>
        </dl>
      </div>
      <.stats_table stats={@stats} values={@values} shown={@shown} />
      <dl :for={p <- Enum.take(@processes, 4)}>
        <dt>Process</dt><dd>{p.number}: {p.status}</dd>
        <dt>In</dt><dd><code>{p.busy_in}</code></dd>
        <dt>Total reductions</dt><dd>{p.reductions}</dd>
        <dt :if={length(p.nodes) > 1}>Shared by</dt>
        <dd :if={length(p.nodes) > 1}>{Enum.join(p.nodes, ", ")}</dd>
      </dl>
      <.stat_charts shown={@shown} selected={@selected} />
    </div>
    """
  end

  defp removed_message(assigns) do
    ~H"""
    <div class="side-title">Gone</div>
    <div class="props"><p class="hint">The selected component is no longer part of the pipeline.</p></div>
    """
  end

  defp stats_table(assigns) do
    ~H"""
    <table class="numbers">
      <tr :for={s <- @stats} :key={s.id}>
        <td><button type="button" class={["plot-it", s.id in @shown && "on"]} phx-click="plot"
            phx-value-stat={s.id} aria-pressed={to_string(s.id in @shown)} title="Plot it"></button></td>
        <th>{s.name}</th>
        <td class="value">{Stats.format_value(s.id, @values[s.id])}</td>
      </tr>
    </table>
    """
  end

  defp stat_charts(assigns) do
    ~H"""
    <div class="charts">
      <figure :for={id <- @shown} :key={id}>
        <figcaption>{stat_name(id)}</figcaption>
        <div id={"plot-#{id}"} class="spark" phx-hook="PipelinePlot" phx-update="ignore" data-stat={id}
            data-unit={stat_unit(id)}></div>
      </figure>
    </div>
    """
  end

  defp stat_name(id), do: id |> Stats.fetch() |> elem(1) |> Map.fetch!(:name)
  defp stat_unit(id), do: id |> Stats.fetch() |> elem(1) |> Map.fetch!(:unit) |> Atom.to_string()

  defp format_clock(ns), do: ns |> Situ.Time.to_iso8601() |> String.slice(11, 12)

  # Messages may be large, so their size is bounded before they become text.
  defp inspect_short(data),
    do: data |> inspect(limit: 12, printable_limit: 160, width: 80) |> String.slice(0, 400)

  # Avoids repetitions such as "Operator, operator".
  defp describe_node(%{module: module, kind: kind}) do
    if String.downcase(to_string(module)) == to_string(kind),
      do: to_string(module),
      else: "#{module}, #{kind}"
  end
end
