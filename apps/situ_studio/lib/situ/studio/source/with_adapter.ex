defmodule Situ.Studio.Source.WithAdapter do
  @moduledoc """
  Wraps a source whose messages are converted by an adapter (`Situ.Studio.Adapter`). Messages that the adapter cannot
  convert are gaps.
  """
  @behaviour Situ.Studio.Source

  alias Situ.Studio.Draw.Bins
  alias Situ.Studio.{Gap, Source}

  @scan 100_000
  @sample 2_000

  @doc "Wraps a source in an adapter. Returns the source unchanged if there is no adapter."
  @spec with_adapter(Source.t(), module() | nil) :: Source.t()
  def with_adapter(source, nil), do: source
  def with_adapter(source, adapter), do: {__MODULE__, {source, adapter}}

  @impl true
  def extent({source, _}), do: Source.call(source, :extent, [])

  @impl true
  def streams({source, _}), do: Source.call(source, :streams, [])

  @impl true
  def marks({source, _}, stream, from, to, limit),
    do: Source.call(source, :marks, [stream, from, to, limit])

  @impl true
  def series(handle, stream, from, to, bin) do
    with {:ok, messages} <- read_adapted(handle, stream, from, to) do
      all = message_list(latest_at(handle, stream, from - 1)) ++ messages
      all = all ++ message_list(next_after(handle, stream, to))
      points = Enum.flat_map(all, &Bins.value_points(&1.originating_time, &1.data))
      {points, raw?} = Bins.fold_points(points, bin, max(div(to - from, bin), 2))
      {:ok, points, raw?}
    end
  end

  defp read_adapted({source, adapter}, stream, from, to) do
    case Source.call(source, :messages, [stream, from, to, @scan]) do
      {:ok, messages, :all} ->
        {:ok, Enum.map(messages, &adapt_message(&1, adapter))}

      {:ok, _, :more} ->
        with {:ok, rows} <- Source.sample_messages(source, stream, from, to, @sample),
             do: {:ok, Enum.map(rows, fn {_, message} -> adapt_message(message, adapter) end)}

      error ->
        error
    end
  end

  defp message_list({:ok, message}), do: [message]
  defp message_list(_), do: []

  @impl true
  def messages({source, adapter}, stream, from, to, limit) do
    with {:ok, messages, more} <- Source.call(source, :messages, [stream, from, to, limit]),
         do: {:ok, Enum.map(messages, &adapt_message(&1, adapter)), more}
  end

  @impl true
  def sample({source, adapter}, stream, from, to, n) do
    with {:ok, rows} <- Source.sample_messages(source, stream, from, to, n),
         do: {:ok, for({i, message} <- rows, do: {i, adapt_message(message, adapter)})}
  end

  @impl true
  def latest_at(handle, stream, time), do: read_message(handle, :latest_at, stream, time)

  @impl true
  def next_after(handle, stream, time), do: read_message(handle, :next_after, stream, time)

  defp read_message({source, adapter}, name, stream, time) do
    with {:ok, message} <- Source.call(source, name, [stream, time]),
         do: {:ok, adapt_message(message, adapter)}
  end

  defp adapt_message(%{data: %Gap{}} = message, _adapter), do: message

  defp adapt_message(message, adapter) do
    case adapter.adapt(message.data, message) do
      {:ok, data} -> %{message | data: data}
      :error -> %{message | data: %Gap{}}
    end
  end
end
