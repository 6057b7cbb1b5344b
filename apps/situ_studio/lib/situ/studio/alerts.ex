defmodule Situ.Studio.Alerts do
  @moduledoc false
  # Raises the alerts of one studio. Once a second its rules (`Situ.Studio.Alerts.Rule`, saved
  # with the settings) are evaluated for its running pipelines. An alert is raised when its rule
  # becomes true and cleared when the rule is no longer true; both times are kept until the rule
  # or the pipeline is removed.
  use GenServer

  alias Situ.Diagnostics.Snapshot
  alias Situ.Expression.Operators
  alias Situ.Studio.Alerts.Rule
  alias Situ.Studio.PipelineView.{Feed, Stats}
  alias Situ.Studio.{Catalog, Settings, StreamReader}

  @tick_ms 1_000

  @typedoc "One alert of a pipeline; `cleared` is `nil` while the alert is active. Times are wall-clock ns."
  @type alert :: %{
          rule: String.t(),
          text: String.t(),
          raised: Situ.Time.t(),
          cleared: Situ.Time.t() | nil
        }

  @doc """
  Starts the alerts of the studio `:id`. With `tick: false`, the caller triggers each evaluation (`evaluate_rules/2`);
  `of:` names a different studio to evaluate.
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @doc "Returns the alerts of the item `title`: active alerts first, then the newest."
  @spec list_alerts(Catalog.id(), String.t()) :: [alert()]
  def list_alerts(id, title) do
    case Registry.lookup(Situ.Studio.Registry, {id, :alerts}) do
      [{_, table}] ->
        for({_, alert} <- :ets.match_object(table, {{title, :_}, :_}), do: alert)
        |> Enum.sort_by(&{&1.cleared != nil, -&1.raised, &1.rule})

      [] ->
        []
    end
  rescue
    # The table was deleted when its process exited.
    ArgumentError -> []
  end

  @doc "Returns the number of active alerts of the item `title`."
  @spec count_active(Catalog.id(), String.t()) :: non_neg_integer()
  def count_active(id, title), do: id |> list_alerts(title) |> Enum.count(&(&1.cleared == nil))

  @doc "Evaluates the rules for the running pipelines at time `now`."
  @spec evaluate_rules(GenServer.server(), Situ.Time.t()) :: :ok
  def evaluate_rules(server, now), do: GenServer.call(server, {:look, now}, 30_000)

  @impl true
  def init(opts) do
    table = :ets.new(__MODULE__, [:ordered_set, :protected])
    {:ok, _} = Registry.register(Situ.Studio.Registry, {opts[:id], :alerts}, table)
    if opts[:tick] != false, do: Process.send_after(self(), :tick, @tick_ms)
    {:ok, %{id: opts[:of] || opts[:id], table: table, earlier: %{}}}
  end

  @impl true
  def handle_call({:look, now}, _from, state), do: {:reply, :ok, update_alerts(state, now)}

  @impl true
  def handle_info(:tick, state) do
    Process.send_after(self(), :tick, @tick_ms)
    {:noreply, update_alerts(state, Situ.Time.now())}
  end

  def handle_info(_, state), do: {:noreply, state}

  defp update_alerts(%{id: id, table: table} = state, now) do
    case Rule.parse_rules(Settings.load(Catalog.settings(id).layouts).alerts) do
      {:ok, [_ | _] = rules} ->
        running = for %{kind: :pipeline, live: true} = item <- Catalog.list(id), do: item.id
        delete_stale_alerts(table, running, rules)

        seen =
          for title <- running,
              into: %{},
              do: {title, evaluate_pipeline(state, title, rules, now)}

        %{state | earlier: Map.reject(seen, fn {_, snapshot} -> snapshot == nil end)}

      _ ->
        :ets.delete_all_objects(table)
        %{state | earlier: %{}}
    end
  end

  # Removes the alerts of rules that were deleted or changed, and of pipelines that are no longer running.
  defp delete_stale_alerts(table, running, rules) do
    known = MapSet.new(rules, &{&1.name, &1.expression.source})

    for {{title, _} = key, alert} <- :ets.tab2list(table),
        {alert.rule, alert.text} not in known or title not in running,
        do: :ets.delete(table, key)
  end

  # A pipeline that has just ended has no snapshot, so its rules are skipped.
  defp evaluate_pipeline(state, title, rules, now) do
    with {:ok, _item, source} <- Catalog.open_source(state.id, title),
         {:ok, {:live, _} = feed} <- Feed.open(source),
         {:ok, %Snapshot{} = snapshot, at} <- Feed.fetch_latest(feed) do
      sample = Stats.compute_sample(snapshot, at, state.earlier[title])

      for rule <- rules,
          do:
            update_alert(
              state.table,
              {title, rule.name},
              rule,
              build_env(rule, source, snapshot, sample),
              now
            )

      {snapshot, at}
    else
      _ -> nil
    end
  end

  defp build_env(rule, source, snapshot, sample) do
    statistics =
      for {name, id, path} <- Rule.referenced_statistics(rule),
          into: %{},
          do: {name, statistic_value(snapshot, sample, id, path)}

    for stream <- Rule.referenced_streams(rule),
        into: statistics,
        do: {stream, latest_value(source, stream)}
  end

  defp statistic_value(snapshot, sample, id, path) do
    {:ok, %{of: of}} = Stats.fetch(id)
    nodes = for node <- snapshot.nodes, node.path == path, do: node.id

    values =
      case of do
        :node -> for n <- nodes, do: sample.nodes[n]
        :edge -> for e <- snapshot.edges, e.to in nodes, do: sample.edges[e.id]
      end

    Stats.merge_values(Enum.reject(values, &is_nil/1))[id]
  end

  defp latest_value(source, stream) do
    with {:ok, extent} <- StreamReader.fetch_extent(source),
         {:ok, message} <- StreamReader.latest_at(source, stream, extent.to) do
      Operators.to_plain(message.data)
    else
      _ -> nil
    end
  end

  defp update_alert(table, key, rule, env, now) do
    raised? = Rule.true?(rule, env)

    case {:ets.lookup(table, key), raised?} do
      {[{_, %{cleared: nil}}], true} ->
        :ok

      {[{_, %{cleared: nil} = alert}], false} ->
        :ets.insert(table, {key, %{alert | cleared: now}})

      {_, true} ->
        :ets.insert(table, {key, new_alert(rule, now)})

      {_, false} ->
        :ok
    end
  end

  defp new_alert(rule, now),
    do: %{rule: rule.name, text: rule.expression.source, raised: now, cleared: nil}
end
