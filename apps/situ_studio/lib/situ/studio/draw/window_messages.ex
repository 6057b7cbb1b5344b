defmodule Situ.Studio.Draw.WindowMessages do
  @moduledoc false
  # Reads the messages that a visualizer draws over time: the messages of a window, the one in
  # force at its start, and the next one, which ends the last state. If a window has too many
  # messages to read, it is sampled evenly by message number.
  alias Situ.Studio.StreamReader

  # A rate cannot be determined from so few messages, because there may be gaps between them. Then this many are read on
  # both sides.
  @few 32
  @neighbours 16

  @scan 200_000
  @sample 1_500

  @typedoc "A message and its position in the stream; the positions of adjacent messages differ by one."
  @type numbered :: {integer(), Situ.Message.t()}
  @typedoc "A `t:Situ.Studio.Visualizer.spec/0`, or a map with only the stream, by name or as its information."
  @type drawn :: %{:stream => Situ.Store.name(), optional(atom()) => term()}

  @doc "Fetches the messages within a window and one or more on both sides; `false` if they are a sample."
  @spec fetch_around(Situ.Recording.t(), drawn(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, [Situ.Message.t()], all? :: boolean()} | {:error, Situ.Error.t()}
  def fetch_around(source, spec, from, to) do
    with {:ok, numbered, all?} <- fetch_numbered(source, spec, from, to),
         do: {:ok, Enum.map(numbered, &elem(&1, 1)), all?}
  end

  @doc "Fetches the same messages with their positions."
  @spec fetch_numbered(Situ.Recording.t(), drawn(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, [numbered()], all? :: boolean()} | {:error, Situ.Error.t()}
  def fetch_numbered(source, %{stream: stream}, from, to) do
    with {:ok, rows, all?} <- read_window(source, stream, from, to) do
      {first, last} = end_positions(rows)
      {before, later} = surrounding_messages(source, stream, {from, to}, length(rows))
      before = Enum.with_index(before, &{first - length(before) + &2, &1})
      later = Enum.with_index(later, &{last + 1 + &2, &1})
      {:ok, before ++ rows ++ later, all?}
    end
  end

  @doc "Fetches only the messages within the window."
  @spec fetch_within(Situ.Recording.t(), String.t(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, [Situ.Message.t()], all? :: boolean()} | {:error, Situ.Error.t()}
  def fetch_within(source, stream, from, to) do
    with {:ok, rows, all?} <- read_window(source, stream, from, to),
         do: {:ok, Enum.map(rows, &elem(&1, 1)), all?}
  end

  defp read_window(source, stream, from, to) do
    case StreamReader.read_messages(source, stream, from, to, @scan) do
      {:ok, messages, :all} ->
        {:ok, Enum.with_index(messages, &{&2, &1}), true}

      {:ok, _, :more} ->
        with {:ok, rows} <- StreamReader.sample_messages(source, stream, from, to, @sample),
             do: {:ok, rows, false}

      error ->
        error
    end
  end

  defp end_positions([]), do: {0, -1}
  defp end_positions([{first, _} | _] = rows), do: {first, rows |> List.last() |> elem(0)}

  @doc """
  Fetches the messages before and after a window of `n` messages. One on each side lets lines reach the edges. If the
  window has too few messages to determine their rate, more are fetched, so that gaps can be detected.
  """
  @spec surrounding_messages(
          Situ.Recording.t(),
          Situ.Store.name(),
          {Situ.Time.t(), Situ.Time.t()},
          non_neg_integer()
        ) ::
          {before :: [Situ.Message.t()], later :: [Situ.Message.t()]}
  def surrounding_messages(source, stream, {from, to}, n) do
    most = if n < @few, do: @neighbours, else: 1
    before = StreamReader.list_neighbours(source, stream, :before, from, most)
    {Enum.reverse(before), StreamReader.list_neighbours(source, stream, :after, to, most)}
  end
end
