defmodule Situ.Space.PoseHistory do
  @moduledoc false
  # Stores the poses of the last `keep` ns by time. Older poses are in a sorted tuple with binary search. The latest
  # few are in a list, latest first, which is merged into the tuple when it is full. Most poses arrive in order and
  # are looked up soon after.
  alias Situ.Pose

  @recent 32

  defstruct sorted: {}, recent: [], count: 0

  @type entry :: {Situ.Time.t(), Pose.t()}
  @type t :: %__MODULE__{sorted: tuple(), recent: [entry()], count: non_neg_integer()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Adds a pose. A later call replaces a pose at the same time. Each merge drops the poses older than `keep` ns, except
  one.
  """
  @spec put(t(), Situ.Time.t(), Pose.t(), Situ.Time.duration()) :: t()
  def put(
        %__MODULE__{recent: [{latest, _} | _] = recent, count: count} = history,
        time,
        pose,
        _keep
      )
      when time > latest and count < @recent,
      do: %{history | recent: [{time, pose} | recent], count: count + 1}

  def put(%__MODULE__{recent: [], sorted: {}} = history, time, pose, _keep),
    do: %{history | recent: [{time, pose}], count: 1}

  def put(%__MODULE__{} = history, time, pose, keep) do
    all = Tuple.to_list(history.sorted) ++ Enum.reverse(history.recent)
    {before, later} = Enum.split_while(all, fn {at, _} -> at < time end)
    all = before ++ [{time, pose} | Enum.drop_while(later, fn {at, _} -> at == time end)]
    {latest, _} = List.last(all)
    %__MODULE__{sorted: all |> drop_older(latest - keep) |> List.to_tuple()}
  end

  # One pose before the span is kept, so that poses can be interpolated in all of the span.
  defp drop_older([_, {second, _} = next | rest], since) when second <= since,
    do: drop_older([next | rest], since)

  defp drop_older(entries, _since), do: entries

  @doc "Returns the times of the oldest and the latest pose."
  @spec time_span(t()) :: {Situ.Time.t(), Situ.Time.t()}
  def time_span(%__MODULE__{sorted: {}, recent: [{latest, _} | _] = recent}),
    do: {recent |> List.last() |> elem(0), latest}

  def time_span(%__MODULE__{sorted: sorted, recent: recent}) do
    {oldest, _} = elem(sorted, 0)
    {latest, _} = if recent == [], do: elem(sorted, tuple_size(sorted) - 1), else: hd(recent)
    {oldest, latest}
  end

  @doc "Returns the pose at a time, the poses on either side of it, or `:outside` if it is not between two poses."
  @spec lookup_around(t(), Situ.Time.t()) ::
          {:exact, Pose.t()} | {:between, entry(), entry()} | :outside
  def lookup_around(%__MODULE__{recent: [{latest, _} | _]}, time) when time > latest, do: :outside

  def lookup_around(%__MODULE__{recent: recent, sorted: sorted}, time),
    do: search_recent(recent, time, nil, sorted)

  defp search_recent([{time, pose} | _], time, _later, _sorted), do: {:exact, pose}

  defp search_recent([{at, _} = entry | _], time, later, _sorted) when at < time,
    do: {:between, entry, later}

  defp search_recent([entry | rest], time, _later, sorted),
    do: search_recent(rest, time, entry, sorted)

  defp search_recent([], _time, _later, {}), do: :outside

  defp search_recent([], time, later, sorted) do
    case count_before(sorted, time, 0, tuple_size(sorted)) do
      0 ->
        if time == elem(elem(sorted, 0), 0),
          do: {:exact, elem(elem(sorted, 0), 1)},
          else: :outside

      n ->
        pose_or_neighbors(
          elem(sorted, n - 1),
          if(n < tuple_size(sorted), do: elem(sorted, n), else: later),
          time
        )
    end
  end

  defp pose_or_neighbors(_before, {time, pose}, time), do: {:exact, pose}
  defp pose_or_neighbors(_before, nil, _time), do: :outside
  defp pose_or_neighbors(before, later, _time), do: {:between, before, later}

  # Returns the number of entries before `time`.
  defp count_before(_sorted, _time, low, high) when low >= high, do: low

  defp count_before(sorted, time, low, high) do
    middle = div(low + high, 2)

    if elem(elem(sorted, middle), 0) < time,
      do: count_before(sorted, time, middle + 1, high),
      else: count_before(sorted, time, low, middle)
  end
end
