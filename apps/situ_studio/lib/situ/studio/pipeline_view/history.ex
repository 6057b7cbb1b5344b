defmodule Situ.Studio.PipelineView.History do
  @moduledoc false
  # Keeps the statistics of the studio's pipelines, so that a page can show them from before it was opened: once a
  # second for the last five minutes, and every ten seconds for the last hour. One process per studio writes them; pages
  # read the table.
  use GenServer

  alias Situ.Studio.PipelineView.{Feed, Stats}
  alias Situ.Studio.{PipelineWatcher, Recordings}

  @tick_ms 1_000
  @fine 300_000_000_000
  @coarse 3_600_000_000_000
  @every 10
  # The maximum size of a pipeline's samples. A pipeline of fifty components takes about 5 kB per sample.
  @max_bytes 16_000_000

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @doc """
  Lists the samples of the pipeline called `title` in the studio `id`, newest first. Times are from the VM's monotonic
  clock.
  """
  @spec list_samples(String.t(), String.t()) :: [Stats.sample()]
  def list_samples(id, title) do
    case Registry.lookup(Situ.Studio.Registry, {id, :past}) do
      [{_, table}] ->
        table |> select_rows(title) |> Enum.map(&:erlang.binary_to_term(elem(&1, 3)))

      [] ->
        []
    end
  rescue
    # The table was deleted with its process.
    ArgumentError -> []
  end

  # Returns `{{title, number}, time, bytes, sample}`, newest first.
  defp select_rows(table, title),
    do: :ets.select_reverse(table, [{{{title, :_}, :_, :_, :_}, [], [:"$_"]}])

  @impl true
  def init(opts) do
    table = :ets.new(__MODULE__, [:ordered_set, :protected])
    {:ok, _} = Registry.register(Situ.Studio.Registry, {opts[:id], :past}, table)
    if opts[:tick] != false, do: send(self(), :tick)
    {:ok, %{pipelines: opts[:pipelines] || [], table: table, earlier: %{}, count: 0}}
  end

  @impl true
  def handle_info(:tick, state) do
    Process.send_after(self(), :tick, @tick_ms)
    handle_info({:tick, System.monotonic_time(:nanosecond)}, state)
  end

  def handle_info({:tick, now}, state) do
    earlier =
      for {title, target} <- Recordings.Pipeline.list_running(state.pipelines),
          {:ok, snapshot} <- [fetch_snapshot(target)],
          into: %{} do
        sample = Stats.compute_sample(snapshot, now, state.earlier[title])
        packed = :erlang.term_to_binary(sample, compressed: 1)
        :ets.insert(state.table, {{title, state.count}, now, byte_size(packed), packed})
        {title, {snapshot, now}}
      end

    delete_old_samples(state.table, now)
    {:noreply, %{state | earlier: earlier, count: state.count + 1}}
  end

  def handle_info(_, state), do: {:noreply, state}

  defp fetch_snapshot(target) do
    {:ok,
     target |> PipelineWatcher.resolve_target() |> Situ.Pipeline.info() |> Feed.without_taps()}
  rescue
    Situ.Error -> :ended
  catch
    :exit, _ -> :ended
  end

  defp delete_old_samples(table, now) do
    old = [{:<, :"$2", now - @coarse}]
    between = [{:<, :"$2", now - @fine}, {:"/=", {:rem, :"$1", @every}, 0}]

    for guards <- [old, between],
        do: :ets.select_delete(table, [{{{:_, :"$1"}, :"$2", :_, :_}, guards, [true]}])

    table
    |> :ets.select([{{{:"$1", :"$2"}, :_, :"$3", :_}, [], [{{:"$1", :"$2", :"$3"}}]}])
    |> Enum.group_by(&elem(&1, 0))
    |> Enum.each(fn {_, rows} -> limit_size(table, rows) end)
  end

  defp limit_size(table, rows) do
    rows
    |> Enum.reverse()
    |> Enum.reduce(0, fn {title, n, bytes}, held ->
      if held + bytes > @max_bytes, do: :ets.delete(table, {title, n})
      held + bytes
    end)
  end
end
