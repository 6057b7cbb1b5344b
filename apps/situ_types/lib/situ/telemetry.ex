defmodule Situ.Telemetry do
  @moduledoc """
  Emits the events of the platform, in the format of the `:telemetry` library.

  If the application has the `:telemetry` library loaded, its handlers receive all events:

      :telemetry.attach("my-app", [:situ, :pipeline, :stop], &MyApp.handle_event/4, nil)

  Situ does not depend on the library. Without it, `attach/4` and `detach/1` of this module do the same.

  A handler that raises is detached and logged once, so a broken observer cannot stop a stream.

  | event | measurements | metadata |
  |---|---|---|
  | `[:situ, :pipeline, :start]` | `system_time` (ns) | `pipeline` |
  | `[:situ, :pipeline, :stop]` | `duration` (ns) | `pipeline`, `errors` (their number), `report` (`Situ.Pipeline.Report`) |
  | `[:situ, :component, :error]` | `originating_time` (ns) | `pipeline`, `component`, `error` |
  | `[:situ, :infer, :load]` | `duration` (native) | `model` |

  The events of a pipeline are emitted by its process.

      iex> Situ.Telemetry.attach("doc", [:situ, :doc], fn _event, m, _meta, pid -> send(pid, m.n) end, self())
      :ok
      iex> Situ.Telemetry.execute([:situ, :doc], %{n: 1}, %{})
      :ok
      iex> receive do n -> n end
      1
      iex> Situ.Telemetry.detach("doc")
      :ok
  """
  require Logger

  # The library is only available if the host application depends on it.
  @compile {:no_warn_undefined, [:telemetry]}
  @table __MODULE__

  @type event :: [atom(), ...]
  @type handler :: (event(), map(), map(), term() -> any())

  @doc "Creates the handler table. The application calls it once."
  @spec create_table() :: :ok
  def create_table do
    if :ets.whereis(@table) == :undefined do
      :ets.new(@table, [:named_table, :public, :bag, read_concurrency: true])
    end

    :ok
  end

  @doc "Attaches `handler` to `event` under a unique `id`."
  @spec attach(term(), event(), handler(), term()) :: :ok | {:error, :already_exists}
  def attach(id, event, handler, config \\ nil) when is_function(handler, 4) do
    case :ets.match(@table, {:_, id, :_, :_}) do
      [] ->
        :ets.insert(@table, {event, id, handler, config})
        :ok

      _ ->
        {:error, :already_exists}
    end
  end

  @doc "Detaches the handler with this `id`."
  @spec detach(term()) :: :ok | {:error, :not_found}
  def detach(id) do
    case :ets.match_object(@table, {:_, id, :_, :_}) do
      [] ->
        {:error, :not_found}

      rows ->
        Enum.each(rows, &:ets.delete_object(@table, &1))
        :ok
    end
  end

  @doc "Calls every handler of `event`, and the handlers of the `:telemetry` library if it is loaded."
  @spec execute(event(), map(), map()) :: :ok
  def execute(event, measurements, metadata) do
    for {_, id, handler, config} = row <- :ets.lookup(@table, event) do
      try do
        handler.(event, measurements, metadata, config)
      catch
        kind, reason ->
          :ets.delete_object(@table, row)

          Logger.error(
            "telemetry handler #{inspect(id)} detached: #{Exception.format(kind, reason)}"
          )
      end
    end

    if function_exported?(:telemetry, :execute, 3),
      do: :telemetry.execute(event, measurements, metadata)

    :ok
  end
end
