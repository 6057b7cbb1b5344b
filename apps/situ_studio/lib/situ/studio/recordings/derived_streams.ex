defmodule Situ.Studio.Recordings.DerivedStreams do
  @moduledoc false
  # Adds derived streams to a recording, which are computed when they are read. A stream called `=
  # EXPRESSION` has a message at the time of every message of the streams that the expression
  # names. Its value is the result of the expression (`Situ.Expression`) for the latest message of
  # each of these streams. The name is the complete definition, so layouts and links can contain
  # derived streams.
  @behaviour Situ.Recording

  alias Situ.{Error, Expression, Recording, Store}
  alias Situ.Studio.{StreamInfo, StreamOverview, StreamReader}
  alias Situ.Studio.Recordings.{ExpressionReader, Origin}

  # The shape of a derived stream is determined from this many values.
  @looked_at 16

  @enforce_keys [:recording]
  defstruct [:recording]

  @type t :: %__MODULE__{recording: Recording.t()}

  @doc """
  Wraps a recording to add derived streams.

      iex> alias Situ.Studio.{History, Recordings, StreamReader}
      iex> history = History.new(live: false)
      iex> message = %Situ.Message{data: 20, originating_time: 5}
      iex> :ok = History.put(history, "Level", message, 8)
      iex> recording = history |> Recordings.History.wrap() |> Recordings.DerivedStreams.wrap()
      iex> {:ok, message} = StreamReader.latest_at(recording, "= Level * 2 + 1", 9)
      iex> {message.originating_time, message.data}
      {5, 41}
  """
  @spec wrap(Recording.t()) :: Recording.t()
  def wrap(recording) do
    state = %__MODULE__{recording: recording}
    %Recording{path: recording.path, module: __MODULE__, state: state}
  end

  @doc """
  Returns whether a name is that of a derived stream.

      iex> Situ.Studio.Recordings.DerivedStreams.derived_name?("= a + 1")
      true
  """
  @spec derived_name?(String.t()) :: boolean()
  def derived_name?(name), do: String.starts_with?(name, "= ")

  @doc """
  Builds the information on the derived stream of an expression. Errors: `:bad_expression`, `:no_stream`, `:constant`
  (the expression names no stream).
  """
  @spec derive_stream(Recording.t(), String.t()) :: {:ok, StreamInfo.t()} | {:error, Error.t()}
  def derive_stream(recording, text) do
    name = "= " <> String.trim(text)

    with {:ok, expression} <- parse_name(name),
         :ok <- check_known(Expression.names(expression), Store.streams(recording)),
         {:ok, info} <- Store.stream_info(recording, name),
         do: {:ok, StreamOverview.describe_stream(info, {detect_shape(recording, info), []})}
  rescue
    error in Error -> {:error, error}
  end

  defp check_known(names, infos) do
    case names -- Enum.map(infos, & &1.name) do
      [] ->
        :ok

      [missing | _] ->
        {:error,
         Error.new(:no_stream, "unknown stream #{inspect(missing)}",
           fix: "put names that contain dots in backticks: `Room.Level`"
         )}
    end
  end

  defp detect_shape(_recording, %{first: nil}), do: :value

  defp detect_shape(recording, %{first: first, last: last} = info) do
    values =
      for i <- 0..(@looked_at - 1),
          time = first + div((last - first) * i, @looked_at - 1),
          {:ok, %{data: data}} when data != nil <- [StreamReader.latest_at(recording, info, time)],
          do: data

    case values |> Enum.map(&StreamInfo.shape_of/1) |> Enum.uniq() do
      [shape] -> shape
      _ -> :value
    end
  end

  @impl true
  def info(%{recording: recording}), do: Store.info(recording)

  @impl true
  def streams(%{recording: recording}),
    do: for(info <- Store.streams(recording), do: Origin.put_origin(info, recording))

  @impl true
  def stream(%{recording: recording}, "= " <> _ = name) do
    with {:ok, expression} <- parse_name(name),
         names = Expression.names(expression),
         {:ok, bases} <- Error.map_ok(names, &Store.stream_info(recording, &1)),
         do: {:ok, build_info(name, expression, bases)}
  end

  def stream(%{recording: recording}, name) do
    with {:ok, info} <- Store.stream_info(recording, name),
         do: {:ok, Origin.put_origin(info, recording)}
  end

  defp build_info(name, expression, bases) do
    timed = Enum.filter(bases, & &1.first)

    %Store.StreamInfo{
      id: nil,
      name: name,
      first: timed |> Enum.map(& &1.first) |> Enum.max(fn -> nil end),
      last: timed |> Enum.map(& &1.last) |> Enum.max(fn -> nil end),
      count: bases |> Enum.map(& &1.count) |> Enum.sum(),
      latency_sum: nil,
      extra: %{type: "derived", summary: :none, expression: expression, bases: bases}
    }
  end

  defp parse_name("= " <> text) do
    with {:ok, expression} <- Expression.parse(text) do
      if Expression.names(expression) == [],
        do:
          {:error,
           Error.new(:constant, "the expression names no stream",
             fix: "name one, such as `Room.Level` (in backticks if the name contains dots)"
           )},
        else: {:ok, expression}
    end
  end

  @impl true
  def request_streams(%{recording: recording}, names) do
    names = names |> Enum.flat_map(&base_names/1) |> Enum.uniq()
    StreamReader.request_streams(recording, names)
  end

  defp base_names("= " <> _ = name) do
    case parse_name(name) do
      {:ok, expression} -> Expression.names(expression)
      {:error, _} -> []
    end
  end

  defp base_names(name), do: [name]

  @impl true
  def seek(%{recording: recording}, %{extra: %{expression: _}} = info, time),
    do: ExpressionReader.seek_position(recording, info, time)

  def seek(_derived, info, time), do: Origin.seek(info, time)

  # The positions of several streams together would have to be searched.
  @impl true
  def latest_at(%{recording: recording}, %{extra: %{expression: _}} = info, time),
    do: ExpressionReader.latest_at(recording, info, time)

  def latest_at(_derived, %{extra: %{origin: {recording, info}}}, time),
    do: Store.latest_at(recording, info, time)

  @impl true
  def read(%{recording: recording}, %{extra: %{expression: _}} = info, ordinal, to, limit, opts),
    do: ExpressionReader.read_messages(recording, info, {ordinal, to, limit}, opts)

  def read(_derived, info, ordinal, to, limit, opts),
    do: Origin.read(info, ordinal, to, limit, opts)

  @impl true
  def summary(_derived, %{extra: %{expression: _}}, _from, _to, _pixels), do: :none
  def summary(_derived, info, from, to, pixels), do: Origin.summary(info, from, to, pixels)

  @impl true
  def tracks(_derived, %{extra: %{expression: _}}, _from, _to, _level, _most), do: :none

  def tracks(_derived, info, from, to, level, most),
    do: Origin.tracks(info, from, to, level, most)
end
