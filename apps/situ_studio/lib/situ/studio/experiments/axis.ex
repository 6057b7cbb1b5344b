defmodule Situ.Studio.Experiments.Axis do
  @moduledoc false
  # The axes of an experiment's charts: each parameter with several values, and the main value of each metric. A
  # position on an axis is a number from 0 to 1. Pure.
  alias Situ.Experiment.{ReportTable, Summary}

  @enforce_keys [:id, :label]
  defstruct [:id, :label, :parameter, :metric, values: [], low: 0, high: 0]

  @typedoc """
  `id` is `p.NAME` or `m.NAME`. `values` are the values of a parameter with their texts, `low` and `high` the ends of a
  scale of numbers.
  """
  @type t :: %__MODULE__{
          id: String.t(),
          label: String.t(),
          parameter: String.t() | nil,
          metric: String.t() | nil,
          values: [{term(), String.t()}],
          low: number() | nil,
          high: number() | nil
        }

  @doc "Returns the names of the parameters of a run, in the order of the experiment."
  @spec parameter_names(map()) :: [String.t()]
  def parameter_names(%{"parameters" => [_ | _] = names}), do: names

  def parameter_names(%{"sets" => [%{"parameters" => set} | _]}),
    do: set |> Map.keys() |> Enum.sort()

  def parameter_names(_), do: []

  @doc "Returns the axes of a run: parameters, then metrics."
  @spec list_axes([Summary.row()], map()) :: [t()]
  def list_axes(rows, run) do
    parameters =
      for name <- parameter_names(run),
          %{values: [_, _ | _]} = axis <- [parameter_axis(name, rows)],
          do: axis

    metrics =
      for %{"name" => name, "main" => main} <- run["metrics"], do: metric_axis(name, main, rows)

    parameters ++ Enum.reject(metrics, &is_nil/1)
  end

  defp parameter_axis(name, rows) do
    values =
      rows
      |> Enum.sort_by(& &1.number)
      |> Enum.map(&{&1.parameters[name], &1.texts[name]})
      |> Enum.uniq_by(&elem(&1, 0))

    axis = %__MODULE__{
      id: "p." <> name,
      label: name,
      parameter: name,
      values: values,
      low: nil,
      high: nil
    }

    if Enum.all?(values, fn {value, _} -> is_number(value) end) do
      values = Enum.sort(values)
      {low, high} = values |> Enum.map(&elem(&1, 0)) |> Enum.min_max(fn -> {0, 0} end)
      %{axis | values: values, low: low, high: high}
    else
      axis
    end
  end

  defp metric_axis(name, main, rows) do
    case for(row <- rows, value = row.metrics[name].value, do: value) do
      [] ->
        nil

      values ->
        {low, high} = Enum.min_max(values)

        %__MODULE__{
          id: "m." <> name,
          label: "#{name}.#{main}",
          metric: name,
          low: low,
          high: high
        }
    end
  end

  @doc """
  Returns the position of a set on an axis, or `nil` if it has no value there.

      iex> axis = %Situ.Studio.Experiments.Axis{id: "p.on", label: "on", parameter: "on", low: 1, high: 5}
      iex> Situ.Studio.Experiments.Axis.locate(axis, %{parameters: %{"on" => 2}})
      0.25
      iex> axis = %{axis | low: nil, high: nil, values: [{"a", "a"}, {"b", "b"}, {"c", "c"}]}
      iex> Situ.Studio.Experiments.Axis.locate(axis, %{parameters: %{"on" => "c"}})
      1.0
  """
  @spec locate(t(), map()) :: float() | nil
  def locate(%__MODULE__{} = axis, row), do: locate_value(axis, value_of(axis, row))

  defp value_of(%{parameter: nil, metric: name}, row), do: row.metrics[name].value
  defp value_of(%{parameter: name}, row), do: row.parameters[name]

  @doc "Returns the position of a value on an axis; values outside of it have positions below 0 or above 1."
  @spec locate_value(t(), term()) :: float() | nil
  def locate_value(%{low: nil, values: values}, value) do
    case Enum.find_index(values, fn {known, _} -> known === value end) do
      nil -> nil
      index -> index / max(length(values) - 1, 1)
    end
  end

  def locate_value(%{low: same, high: same}, value), do: if(is_number(value), do: 0.5)
  def locate_value(%{low: low, high: high}, x) when is_number(x), do: (x - low) / (high - low)
  def locate_value(_axis, _value), do: nil

  @doc "Returns the marks of an axis, as `{position, text}`: the values of a parameter, or the ends of a metric."
  @spec list_marks(t()) :: [{float(), String.t()}]
  def list_marks(%{parameter: nil, low: low, high: high} = axis) do
    for value <- Enum.uniq([low, high]),
        do: {locate_value(axis, value), ReportTable.format_value(value)}
  end

  def list_marks(%{values: values} = axis),
    do: for({value, text} <- values, do: {locate_value(axis, value), text})

  @doc """
  Returns whether a set is within all ranges. `ranges` maps ids of axes to `{from, to}`, positions from 0 to 1.
  """
  @spec within?(map(), [t()], %{String.t() => {number(), number()}}) :: boolean()
  def within?(row, axes, ranges) do
    Enum.all?(axes, fn axis ->
      case ranges[axis.id] do
        nil ->
          true

        {from, to} ->
          at = locate(axis, row)
          at != nil and at >= from - 1.0e-9 and at <= to + 1.0e-9
      end
    end)
  end
end
