defmodule Situ.Studio.Recordings.History do
  @moduledoc """
  Opens a `Situ.Studio.History` as a `Situ.Recording`, which the studio shows and `Situ.Store` reads. A stream that has
  no messages yet is an empty stream.

      iex> history = Situ.Studio.History.new(seconds: 60)
      iex> recording = Situ.Studio.Recordings.History.wrap(history)
      iex> Situ.Store.count(recording, "level")
      0
  """
  @behaviour Situ.Recording

  alias Situ.{Error, Recording}
  alias Situ.Store.StreamInfo
  alias Situ.Studio.History

  @doc "Returns the recording of a history."
  @spec wrap(History.t()) :: Recording.t()
  def wrap(%History{} = history), do: %Recording{module: __MODULE__, state: history}

  @impl true
  def info(%History{live: live}) do
    now = Situ.Time.now()
    %{name: nil, created: nil, closed?: not live, live?: live, damage: [], now: now}
  end

  @impl true
  def streams(history), do: Enum.map(History.list_streams(history), &build_info/1)

  @impl true
  def stream(history, name) do
    case History.fetch_stream(history, name) do
      {:ok, row} -> {:ok, build_info(row)}
      :none -> {:ok, empty_info(name)}
    end
  rescue
    error in Error -> {:error, error}
  end

  @doc "Returns the information on a stream that has no messages yet."
  @spec empty_info(String.t()) :: StreamInfo.t()
  def empty_info(name),
    do: %StreamInfo{id: nil, name: name, latency_sum: nil, extra: %{summary: :none}}

  defp build_info(row) do
    info = empty_info(row.name)
    extra = Map.put(info.extra, :stored, row.stored)
    figures = %{type: row.type, count: row.count, first: row.first, last: row.last}
    Map.merge(%{info | size: row.total, extra: extra}, figures)
  end

  @impl true
  def seek(history, info, time), do: {:ok, History.find_ordinal(history, info.name, time)}

  @impl true
  def read(history, info, ordinal, to, limit, opts) do
    {messages, next} =
      History.read_messages(history, info.name, ordinal, to, {limit, opts[:total]})

    {:ok, messages, next}
  rescue
    error in Error -> {:error, error}
  end
end
