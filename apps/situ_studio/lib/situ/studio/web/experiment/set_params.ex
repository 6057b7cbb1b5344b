defmodule Situ.Studio.Web.Experiment.SetParams do
  @moduledoc false
  # The state of the page of experiments, as parameters of its address. Pure.
  alias Situ.Studio.Experiments.Axis

  @most_ranges 20

  defstruct [:run, :set, :over, :metric, sort: "", ranges: %{}]

  @typedoc """
  `over` is the parameter of the curves and `metric` the metric of the curves and of the ranked sessions. `ranges` are
  the brushed parts of axes, by their ids.
  """
  @type t :: %__MODULE__{
          run: String.t() | nil,
          set: String.t() | nil,
          over: String.t() | nil,
          metric: String.t() | nil,
          sort: String.t(),
          ranges: %{String.t() => {number(), number()}}
        }

  @doc "Reads the parameters of an address. Invalid parts are ignored."
  @spec parse(map()) :: t()
  def parse(params) do
    text = fn name -> if is_binary(params[name]) and params[name] != "", do: params[name] end

    %__MODULE__{
      run: text.("run"),
      set: text.("set"),
      over: text.("over"),
      metric: text.("metric"),
      sort: text.("sort") || "",
      ranges: parse_ranges(text.("ranges"))
    }
  end

  defp parse_ranges(nil), do: %{}

  defp parse_ranges(text) do
    case Situ.JSON.decode(text) do
      {:ok, list} when is_list(list) ->
        for [id, from, to] <- Enum.take(list, @most_ranges),
            is_binary(id) and is_number(from) and is_number(to),
            into: %{},
            do: {id, {from, to}}

      _ ->
        %{}
    end
  end

  @doc """
  Returns the parameters of an address.

      iex> alias Situ.Studio.Web.Experiment.SetParams
      iex> shown = %SetParams{sort: "-set", ranges: %{"p.on" => {0.25, 0.5}}}
      iex> SetParams.encode(shown)
      %{"ranges" => ~s([["p.on",0.25,0.5]]), "sort" => "-set"}
      iex> shown |> SetParams.encode() |> SetParams.parse() == shown
      true
  """
  @spec encode(t()) :: %{String.t() => String.t()}
  def encode(%__MODULE__{} = shown) do
    ranges = for {id, {from, to}} <- Enum.sort(shown.ranges), do: [id, from, to]

    %{
      "run" => shown.run,
      "set" => shown.set,
      "over" => shown.over,
      "metric" => shown.metric,
      "sort" => shown.sort,
      "ranges" => if(ranges != [], do: Situ.JSON.encode(ranges))
    }
    |> Map.reject(fn {_, value} -> value in [nil, ""] end)
  end

  @doc "Returns the state of the page after an event."
  @spec apply_event(t(), {event :: String.t(), map()}, [Axis.t()]) :: t()
  # Another run has other sets.
  def apply_event(shown, {"choose", %{"run" => run}}, _axes)
      when is_binary(run) and run != shown.run,
      do: %__MODULE__{run: run}

  def apply_event(shown, {"choose", params}, _axes) do
    text = fn name, before -> if is_binary(params[name]), do: params[name], else: before end
    %{shown | over: text.("over", shown.over), metric: text.("metric", shown.metric)}
  end

  # The first click on a metric sorts the highest value first, and the second click reverses the order.
  def apply_event(shown, {"sort", %{"column" => column}}, _axes) when is_binary(column) do
    first = if String.starts_with?(column, "m."), do: "-" <> column, else: column
    second = if first == column, do: "-" <> column, else: column
    %{shown | sort: if(shown.sort == first, do: second, else: first)}
  end

  def apply_event(shown, {"select", %{"set" => set}}, _axes)
      when is_binary(set) or is_integer(set),
      do: %{shown | set: to_string(set)}

  def apply_event(shown, {"brush", %{"axis" => id, "from" => from, "to" => to}}, axes)
      when is_number(from) and is_number(to) do
    if Enum.any?(axes, &(&1.id == id)),
      do: %{
        shown
        | ranges: Map.put(shown.ranges, id, {max(min(from, to), 0), min(max(from, to), 1)})
      },
      else: shown
  end

  def apply_event(shown, {"clear", %{"axis" => id}}, _axes),
    do: %{shown | ranges: Map.delete(shown.ranges, id)}

  def apply_event(shown, {"clear", _}, _axes), do: %{shown | ranges: %{}}
  def apply_event(shown, _event, _axes), do: shown
end
