defmodule Situ.Component.LogContext do
  @moduledoc false
  # Adds the component and the originating time to every log line that is written while a component handles messages.
  #
  # `Situ.Component.Callback` and `Situ.Operator.Chain` note the messages that they handle in the process dictionary:
  #
  #   :situ_handling   {path of the component, originating time | batch | nil}
  #   :situ_left       the items of a chain's batch that it has not handled yet
  #
  # Only a log line reads this, by a filter of Erlang's logger in the process that writes the line. A chain notes its
  # progress every few messages, so the time of one line is between two times.
  alias Situ.Delivery.Batch
  alias Situ.Operator.Chain

  @filter :situ_component

  @doc "Adds the filter to the logger."
  @spec install() :: :ok
  def install do
    _ = :logger.add_primary_filter(@filter, {&__MODULE__.add_context/2, nil})
    :ok
  end

  @doc "Removes the filter."
  @spec uninstall() :: :ok
  def uninstall do
    _ = :logger.remove_primary_filter(@filter)
    :ok
  end

  @doc "Returns the context of the calling process, for a process that works for it."
  @spec capture() :: {term(), keyword()}
  def capture, do: {Process.get(:situ_handling), Logger.metadata()}

  @doc "Takes over the context of another process."
  @spec restore({term(), keyword()}) :: :ok
  def restore({handling, metadata}) do
    Process.put(:situ_handling, handling)
    Logger.metadata(metadata)
  end

  @doc "Adds metadata to an event of Erlang's logger. The filter; it must never raise."
  @spec add_context(:logger.log_event(), term()) :: :logger.log_event() | :ignore
  def add_context(%{meta: meta} = event, _config) do
    case Process.get(:situ_handling) do
      {path, handled} ->
        times = list_times(handled, Process.get(:situ_left))
        %{event | meta: meta |> put_component(path) |> put_times(times)}

      nil ->
        :ignore
    end
  end

  # A component given in the call itself remains.
  defp put_component(meta, path) do
    own = Map.get(:logger.get_process_metadata() |> or_empty(), :component)
    if Map.get(meta, :component) in [nil, own], do: Map.put(meta, :component, path), else: meta
  end

  defp or_empty(%{} = metadata), do: metadata
  defp or_empty(:undefined), do: %{}

  defp put_times(meta, []), do: meta
  defp put_times(meta, [time]), do: Map.put_new(meta, :originating_time, time)

  defp put_times(meta, times) do
    if is_map_key(meta, :originating_time) do
      meta
    else
      Map.merge(meta, %{
        originating_time: hd(times),
        last_originating_time: List.last(times)
      })
    end
  end

  defp list_times(nil, _left), do: []
  defp list_times(time, _left) when is_integer(time), do: [time]
  defp list_times(batch, nil), do: batch |> Batch.times() |> Enum.map(&(Batch.base(batch) + &1))

  defp list_times(batch, left) do
    times = list_times(batch, nil)
    times |> Enum.drop(length(times) - length(left)) |> Enum.take(Chain.messages_per_note())
  end
end
