defmodule Situ.Studio.Draw.Messages do
  @moduledoc """
  The messages that a visualizer over time draws: those of a window, with what is in force at its beginning and until
  when that holds at its end. Of more than can be read at once, a sample over the whole window, evenly by number.
  """
  alias Situ.Studio.{Source, Visualizer}

  # Of so few messages nobody can tell how often they come, as holes may lie among them: so many on both sides say it.
  @few 32
  @beside 16

  @scan 200_000
  @sample 1_500

  @typedoc "A message and its place in the stream; neighbours in the stream differ by one."
  @type numbered :: {integer(), Situ.Message.t()}

  @doc "Those within, and one or some on both sides (`beside/4`); `false` when they are a sample."
  @spec around(Source.t(), Visualizer.spec(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, [Situ.Message.t()], all? :: boolean()} | {:error, Situ.Error.t()}
  def around(source, spec, from, to) do
    with {:ok, numbered, all?} <- numbered(source, spec, from, to),
         do: {:ok, Enum.map(numbered, &elem(&1, 1)), all?}
  end

  @doc "The same with their places."
  @spec numbered(Source.t(), Visualizer.spec(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, [numbered()], all? :: boolean()} | {:error, Situ.Error.t()}
  def numbered(source, %{stream: stream}, from, to) do
    with {:ok, rows, all?} <- read(source, stream, from, to) do
      {first, last} = ends(rows)
      {before, later} = beside(source, stream, {from, to}, length(rows))
      before = Enum.with_index(before, &{first - length(before) + &2, &1})
      later = Enum.with_index(later, &{last + 1 + &2, &1})
      {:ok, before ++ rows ++ later, all?}
    end
  end

  @doc "Those within the window only."
  @spec within(Source.t(), String.t(), Situ.Time.t(), Situ.Time.t()) ::
          {:ok, [Situ.Message.t()], all? :: boolean()} | {:error, Situ.Error.t()}
  def within(source, stream, from, to) do
    with {:ok, rows, all?} <- read(source, stream, from, to),
         do: {:ok, Enum.map(rows, &elem(&1, 1)), all?}
  end

  defp read(source, stream, from, to) do
    case Source.call(source, :messages, [stream, from, to, @scan]) do
      {:ok, messages, :all} ->
        {:ok, Enum.with_index(messages, &{&2, &1}), true}

      {:ok, _, :more} ->
        with {:ok, rows} <- Source.sample(source, stream, from, to, @sample),
             do: {:ok, rows, false}

      error ->
        error
    end
  end

  defp ends([]), do: {0, -1}
  defp ends([{first, _} | _] = rows), do: {first, rows |> List.last() |> elem(0)}

  @doc """
  The messages before and after a window of `n` messages: one on both sides, so that lines reach the edges; some more
  where the window has too few to tell how often they come, which tells holes.
  """
  @spec beside(Source.t(), String.t(), {Situ.Time.t(), Situ.Time.t()}, non_neg_integer()) ::
          {before :: [Situ.Message.t()], later :: [Situ.Message.t()]}
  def beside(source, stream, {from, to}, n) do
    most = if n < @few, do: @beside, else: 1
    before = Source.neighbours(source, stream, :before, from, most)
    {Enum.reverse(before), Source.neighbours(source, stream, :after, to, most)}
  end
end
