defmodule Situ.Metrics do
  @moduledoc """
  The pipelines of this node as metrics, in the text format of Prometheus.

      iex> {:ok, p} = Situ.Pipeline.start(
      ...>   fn p -> p |> Situ.timer(every: Situ.Time.ms(1)) |> Situ.each(& &1, name: "Sink", async: true) end,
      ...>   pipeline: [name: "Doc metrics"]
      ...> )
      iex> text = Situ.Metrics.to_text(Situ.Metrics.collect())
      iex> text =~ ~s(situ_pipeline_running{pipeline="Doc metrics"})
      true
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> :done
      :done

  The studio and `Situ.Metrics.Server` serve them at `/metrics`. All names begin with `situ_`; durations are in seconds
  and sizes in bytes.

  | metric | kind | labels |
  |---|---|---|
  | `pipeline_running`, `pipeline_uptime_seconds` | gauge | `pipeline` |
  | `messages_emitted_total`, `messages_processed_total`, `messages_dropped_total` | counter | `pipeline`, `from`, `to` |
  | `queue_messages` | gauge | `pipeline`, `from`, `to` |
  | `latency_seconds` | histogram | `pipeline`, `from`, `to` |
  | `handling_seconds_total` | counter | `pipeline`, `from`, `to` |
  | `component_errors_total`, `component_restarts_total`, `component_skipped_total` | counter | `pipeline`, `component` |
  | `process_memory_bytes`, `process_mailbox_messages` | gauge | `pipeline`, `component` |
  | `vm_memory_bytes` | gauge | `kind` |
  | `vm_processes`, `vm_run_queue` | gauge | |
  | `vm_uptime_seconds` | gauge | |
  | `store_written_bytes_total` | counter | `store` |
  | `link_connected`, `link_round_trip_seconds` | gauge | `address` |
  | `link_connections_total`, `link_received_bytes_total` | counter | `address` |
  | `link_received_messages_total`, `link_lost_messages_total` | counter | `address`, `stream` |
  | `link_lag_seconds`, `link_waiting_bytes` | gauge | `address`, `stream` |
  | `cluster_nodes`, `node_busy_cores`, `node_cores`, `machine_load` | gauge | |
  | `round_trip_seconds` | gauge | `peer` |
  | `cluster_lease_held`, `cluster_lease_epoch` | gauge | `deployment`, `part` |

  `from` and `to` are an output and an input (`"Mouth.Crop.out"`). Connections inside a process have no queue and are
  left out. A label `component` of a process names the first of its components. `latency_seconds` is the time from a
  message's originating time to its delivery. The limits of its buckets are powers of two of nanoseconds, from 16 us to
  69 s. Under load, the last message of a batch is measured for all.

  A pipeline has at most 500 series of each metric. The components and connections that were added after the first 500
  are reported together, with `"(others)"` as the name.

  Stores, links and leases are reported while a pipeline of this node writes or opens them. `store_written_bytes_total`
  includes earlier segments of a recording. `link_lag_seconds` is how much older the last message was than the sender's
  clock when the pipeline took it. It grows while received messages wait or the connection is lost.

  ## Your own metrics

  An application adds metrics with a module that implements `c:collect_metrics/0`. It lists the module in
  `application/0` of its `mix.exs`: `env: [metrics: [MyApp.Metrics]]`.

      defmodule MyApp.Metrics do
        @behaviour Situ.Metrics

        @impl true
        def collect_metrics,
          do: [%{name: "lobby_visitors_total", type: :counter, help: "Visitors so far.", samples: [{[], 3}]}]
      end
  """
  alias Situ.Application.Directory
  alias Situ.Metrics.{PipelineMetrics, TextFormat, VmMetrics}
  alias Situ.Pipeline.Client

  require Logger

  # A pipeline that does not respond for this long is left out, in ms.
  @timeout 2_000

  @typedoc "Names and values of labels, which distinguish the samples of a metric."
  @type labels :: [{atom(), String.t()}]

  @typedoc """
  One metric. `name` consists of letters, digits and underscores. Samples of a summary have the third element
  `:quantile`, `:sum` or `:count`. Samples of a histogram have `:bucket`, `:sum` or `:count`. A bucket has a label `le`,
  and counts all values up to this limit.
  """
  @type metric :: %{
          name: String.t(),
          type: :counter | :gauge | :summary | :histogram,
          help: String.t(),
          samples: [
            {labels(), number()} | {labels(), number(), :quantile | :bucket | :sum | :count}
          ]
        }

  @doc "Returns the current metrics of an application."
  @callback collect_metrics() :: [metric()]

  @doc """
  Returns the metrics of the pipelines that run on this node, of the VM, and of all applications that add their own. An
  application whose metrics fail is left out, with a warning in the log.
  """
  @spec collect() :: [metric()]
  def collect do
    pipelines =
      for {_name, pid} <- Directory.list_pipelines(),
          {:ok, snapshot} <- [Client.fetch_snapshot(pid, @timeout)],
          {:ok, counters} <- [Client.fetch_counters(pid, @timeout)],
          do: {snapshot, counters}

    PipelineMetrics.build_metrics(pipelines) ++ VmMetrics.collect_metrics() ++ collect_own()
  end

  @doc """
  Returns the unhealthy pipelines of this node with the reason. A pipeline is unhealthy if it does not respond, or if
  `expected` names it and it is not running.

      iex> Situ.Metrics.unhealthy_pipelines(["Door"])
      [{"Door", "is not running"}]
  """
  @spec unhealthy_pipelines([String.t()]) :: [{name :: String.t(), reason :: String.t()}]
  def unhealthy_pipelines(expected \\ []) do
    found = for {name, pid} <- Directory.list_pipelines(), do: {name, describe_health(pid)}

    missing =
      for name <- expected, not List.keymember?(found, name, 0), do: {name, "is not running"}

    Enum.sort(missing ++ Enum.filter(found, &elem(&1, 1)))
  end

  @doc """
  Returns the body of a response about health, to be encoded as JSON.

      iex> Situ.Metrics.health_report([])
      %{status: "ok"}
      iex> Situ.Metrics.health_report([{"Door", "is not running"}])
      %{status: "unhealthy", pipelines: %{"Door" => "is not running"}}
  """
  @spec health_report([{String.t(), String.t()}]) :: map()
  def health_report([]), do: %{status: "ok"}
  def health_report(unhealthy), do: %{status: "unhealthy", pipelines: Map.new(unhealthy)}

  defp describe_health(pid) do
    case Client.fetch_snapshot(pid, @timeout) do
      {:error, %{code: :timeout}} -> "does not respond"
      _ -> nil
    end
  end

  defp collect_own do
    for {app, _, _} <- Application.loaded_applications(),
        module <- Application.get_env(app, :metrics, []),
        metric <- collect_safely(module),
        do: metric
  end

  defp collect_safely(module) do
    module.collect_metrics()
  rescue
    error -> leave_out(module, Exception.message(error))
  catch
    :exit, reason -> leave_out(module, Exception.format_exit(reason))
  end

  defp leave_out(module, why) do
    Logger.warning("the metrics of #{inspect(module)} are left out: #{why}")
    []
  end

  @doc """
  Writes metrics in the text format of Prometheus, version 0.0.4. Metrics with the same name are joined, and one with an
  invalid name is left out.

      iex> metric = %{name: "door_open", type: :gauge, help: "Whether it is open.", samples: [{[door: "main"], 1}]}
      iex> Situ.Metrics.to_text([metric])
      "# HELP door_open Whether it is open.\\n# TYPE door_open gauge\\ndoor_open{door=\\"main\\"} 1\\n"
  """
  @spec to_text([metric()]) :: String.t()
  def to_text(metrics), do: metrics |> TextFormat.encode() |> IO.iodata_to_binary()

  @doc "Returns the content type of `to_text/1`."
  @spec content_type() :: String.t()
  def content_type, do: "text/plain; version=0.0.4; charset=utf-8"
end
