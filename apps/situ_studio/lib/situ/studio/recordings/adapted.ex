defmodule Situ.Studio.Recordings.Adapted do
  @moduledoc false
  # Wraps a recording whose messages are converted by an adapter (`Situ.Studio.Adapter`). Messages
  # that the adapter cannot convert are gaps.
  @behaviour Situ.Recording

  alias Situ.{Message, Recording, Store}
  alias Situ.Studio.Gap
  alias Situ.Studio.Recordings.Origin

  @doc "Wraps a recording in an adapter. Returns the recording unchanged if there is no adapter."
  @spec wrap(Recording.t(), module() | nil) :: Recording.t()
  def wrap(recording, nil), do: recording

  def wrap(recording, adapter),
    do: %Recording{path: recording.path, module: __MODULE__, state: {recording, adapter}}

  @impl true
  def info({recording, _}), do: Store.info(recording)

  @impl true
  def streams({recording, _}),
    do: for(info <- Store.streams(recording), do: convert_info(info, recording))

  @impl true
  def stream({recording, _}, name) do
    with {:ok, info} <- Store.stream_info(recording, name),
         do: {:ok, convert_info(info, recording)}
  end

  # The stored summary is that of other data.
  defp convert_info(info, recording) do
    info = Origin.put_origin(info, recording)
    extra = info.extra |> Map.take([:origin, :path, :stored, :bases]) |> Map.put(:summary, :none)
    %{info | type: :any, extra: extra}
  end

  @impl true
  def latest_at({_, adapter}, %{extra: %{origin: {recording, info}}}, time) do
    with {:ok, %Message{} = message} <- Store.latest_at(recording, info, time),
         do: {:ok, adapt_message(message, adapter)}
  end

  @impl true
  def seek(_state, info, time), do: Origin.seek(info, time)

  @impl true
  def read({_, adapter}, info, ordinal, to, limit, opts) do
    with {:ok, messages, next} <- Origin.read(info, ordinal, to, limit, opts) do
      if opts[:envelopes],
        do: {:ok, messages, next},
        else: {:ok, Enum.map(messages, &adapt_message(&1, adapter)), next}
    end
  end

  defp adapt_message(%{data: %Gap{}} = message, _adapter), do: message

  defp adapt_message(message, adapter) do
    case adapter.adapt(message.data, message) do
      {:ok, data} -> %{message | data: data}
      :error -> %{message | data: %Gap{}}
    end
  end
end
