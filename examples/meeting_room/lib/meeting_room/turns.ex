defmodule MeetingRoom.Turns do
  @moduledoc """
  Who spoke in the last minute: for each person, the intervals in which he or she spoke.

      iex> alias MeetingRoom.Turns
      iex> turns = Turns.new() |> Turns.add(0, %{1 => true}) |> Turns.add(40, %{1 => true, 2 => true})
      iex> turns |> Turns.add(80, %{1 => false, 2 => true}) |> Turns.speaker(30, 80)
      2
  """
  @type t :: %{last: Situ.Time.t() | nil, spans: %{term() => [{Situ.Time.t(), Situ.Time.t()}]}}

  @kept Situ.Time.min(1)

  @doc "Returns turns in which nobody has spoken."
  @spec new() :: t()
  def new, do: %{last: nil, spans: %{}}

  @doc "Adds who speaks from the previous time to `time`."
  @spec add(t(), Situ.Time.t(), %{term() => boolean()}) :: t()
  def add(%{last: last, spans: spans}, time, speaking) do
    spans =
      for {person, true} <- speaking, reduce: spans do
        spans -> Map.update(spans, person, [{last || time, time}], &extend(&1, last, time))
      end

    %{last: time, spans: spans}
  end

  defp extend([{from, last} | older], last, time), do: [{from, time} | older]

  defp extend(spans, last, time),
    do: [{last, time} | Enum.filter(spans, &(elem(&1, 1) > time - @kept))]

  @doc "Returns who spoke most from `from` to `to`, or `nil` if nobody spoke for half of that time."
  @spec speaker(t(), Situ.Time.t(), Situ.Time.t()) :: term() | nil
  def speaker(%{spans: spans}, from, to) do
    {person, spoken} =
      spans
      |> Enum.map(fn {person, spans} -> {person, overlap(spans, from, to)} end)
      |> Enum.max_by(&elem(&1, 1), fn -> {nil, 0} end)

    if 2 * spoken >= to - from, do: person
  end

  defp overlap(spans, from, to),
    do: Enum.sum(for {a, b} <- spans, do: max(min(b, to) - max(a, from), 0))
end
