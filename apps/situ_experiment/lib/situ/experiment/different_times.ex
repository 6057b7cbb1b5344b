defmodule Situ.Experiment.DifferentTimes do
  @moduledoc false
  # Finds the times at which two outputs differ, and which of them is right. Pure. Without a baseline, the output is
  # compared with the truth.
  alias Situ.Message

  @type segments :: [{Situ.Time.t(), Situ.Time.t(), label :: String.t()}]
  @type difference :: {Situ.Time.t(), Situ.Time.t(), verdict :: String.t()}

  @doc """
  Compares the labels of a track. The verdict is `better` where only the set agrees with the truth, `worse` where only
  the baseline does, and `different` otherwise.

      iex> alias Situ.Experiment.DifferentTimes
      iex> lanes = %{truth: [{0, 10, "a"}], baseline: [{0, 6, "a"}], run: [{2, 10, "a"}]}
      iex> DifferentTimes.compare_segments(lanes)
      [{0, 2, "worse"}, {6, 10, "better"}]
      iex> DifferentTimes.compare_segments(%{truth: [{0, 10, "a"}], run: [{5, 12, "a"}]})
      [{0, 5, "missed"}, {10, 12, "false"}]
  """
  @spec compare_segments(%{optional(:truth | :baseline | :run) => segments()}) :: [difference()]
  def compare_segments(lanes) do
    lanes
    |> Map.values()
    |> Enum.concat()
    |> Enum.flat_map(fn {from, to, _} -> [from, to] end)
    |> Enum.uniq()
    |> Enum.sort()
    |> compare_pieces(Map.new(lanes, fn {side, segments} -> {side, Enum.sort(segments)} end), [])
    |> join_pieces()
  end

  # The labels are constant between two neighboring times.
  defp compare_pieces([from, to | rest], lanes, found) do
    lanes =
      Map.new(lanes, fn {side, segments} ->
        {side, Enum.drop_while(segments, &(elem(&1, 1) <= from))}
      end)

    verdict =
      lanes
      |> Map.new(fn {side, segments} -> {side, label_at(segments, from)} end)
      |> judge_labels()

    compare_pieces([to | rest], lanes, [{from, to, verdict} | found])
  end

  defp compare_pieces(_, _lanes, found), do: Enum.reverse(found)

  defp label_at(segments, time) do
    Enum.find_value(segments, fn {from, to, label} -> if from <= time and time < to, do: label end)
  end

  defp judge_labels(%{run: same, baseline: same}), do: nil
  defp judge_labels(%{run: same, truth: same, baseline: _}), do: "better"
  defp judge_labels(%{baseline: same, truth: same}), do: "worse"
  defp judge_labels(%{baseline: _}), do: "different"
  defp judge_labels(%{run: same, truth: same}), do: nil
  defp judge_labels(%{run: nil}), do: "missed"
  defp judge_labels(%{truth: nil}), do: "false"
  defp judge_labels(_), do: "wrong"

  defp join_pieces(pieces) do
    pieces
    |> Enum.reduce([], fn
      {_, _, nil}, joined -> joined
      {from, to, verdict}, [{first, from, verdict} | joined] -> [{first, to, verdict} | joined]
      piece, joined -> [piece | joined]
    end)
    |> Enum.reverse()
  end

  @doc """
  Compares messages at equal times. Neighboring different messages are one difference, which lasts until the next
  message. Numbers are judged by their distance to the truth.

      iex> alias Situ.Experiment.DifferentTimes
      iex> messages = fn values ->
      ...>   for {x, t} <- Enum.with_index(values),
      ...>       do: %Situ.Message{data: x, originating_time: t, creation_time: t, sequence_id: t}
      ...> end
      iex> sides = %{truth: messages.([1, 2, 3, 4]), baseline: messages.([1, 5, 6, 4]), run: messages.([1, 2, 3, 4])}
      iex> DifferentTimes.compare_messages(sides)
      [{1, 3, "better"}]
  """
  @spec compare_messages(%{
          run: [Message.t()],
          truth: [Message.t()],
          baseline: [Message.t()] | nil
        }) :: [
          difference()
        ]
  def compare_messages(sides) do
    values = Map.new(sides, fn {side, messages} -> {side, values_by_time(messages || [])} end)
    against = if sides.baseline, do: values.baseline, else: values.truth
    times = (Map.keys(values.run) ++ Map.keys(against)) |> Enum.uniq() |> Enum.sort()

    times
    |> Enum.zip(Enum.drop(times, 1) ++ Enum.take(times, -1))
    |> Enum.map(fn {from, to} ->
      {from, to,
       judge_values(values.run[from], against[from], {sides.baseline, values.truth[from]})}
    end)
    |> join_pieces()
  end

  defp values_by_time(messages), do: Map.new(messages, &{&1.originating_time, {:value, &1.data}})

  defp judge_values(same, same, _truth), do: nil
  defp judge_values(_run, _truth, {nil, _}), do: "wrong"

  defp judge_values({:value, run}, {:value, baseline}, {_, {:value, truth}})
       when is_number(run) and is_number(baseline) and is_number(truth) do
    if abs(run - truth) <= abs(baseline - truth), do: "better", else: "worse"
  end

  defp judge_values(_run, _baseline, _truth), do: "different"
end
