defmodule Situ.Experiment.Parameters do
  @moduledoc false
  # Sets of parameters: all combinations of the values, their names for people and their form in JSON.
  alias Situ.{Error, Time}

  @enforce_keys [:number, :values, :json, :texts, :label]
  defstruct [:number, :values, :json, :texts, :label]

  @typedoc """
  `json` identifies the set in files; `texts` and `label` are for people: `400 ms`, `threshold=0.5 window=400 ms`.
  """
  @type t :: %__MODULE__{
          number: pos_integer(),
          values: map(),
          json: map(),
          texts: %{String.t() => String.t()},
          label: String.t()
        }

  @most_sets 100_000

  @doc """
  Returns all combinations, numbered from 1; the last parameter changes first.

      iex> {:ok, sets} = Situ.Experiment.Parameters.list_sets(on: [0.4, 0.5], hold: {:time_ns, [0, 200_000_000]})
      iex> Enum.map(sets, &{&1.number, &1.label})
      [{1, "on=0.4 hold=0 ns"}, {2, "on=0.4 hold=200 ms"}, {3, "on=0.5 hold=0 ns"}, {4, "on=0.5 hold=200 ms"}]
  """
  @spec list_sets(keyword()) :: {:ok, [t()]} | {:error, Error.t()}
  def list_sets(parameters) do
    with :ok <- check_parameters(parameters) do
      sets =
        parameters
        |> Enum.map(fn {name, values} -> for v <- plain_values(values), do: {name, v, values} end)
        |> combine()
        |> Enum.with_index(1)
        |> Enum.map(fn {set, number} -> build_set(set, number) end)

      {:ok, sets}
    end
  end

  defp check_parameters(parameters) do
    wrong =
      Keyword.keyword?(parameters) && Enum.find(parameters, fn {_, v} -> not value_list?(v) end)

    cond do
      not Keyword.keyword?(parameters) ->
        {:error, parameter_error("parameters/0 returned #{inspect(parameters, limit: 5)}")}

      wrong ->
        {:error,
         parameter_error("parameter #{elem(wrong, 0)} is #{inspect(elem(wrong, 1), limit: 5)}")}

      count_sets(parameters) > @most_sets ->
        {:error,
         Error.new(:too_many_sets, "the parameters have #{count_sets(parameters)} combinations",
           why: "at most #{@most_sets} are possible",
           fix: "give fewer values"
         )}

      true ->
        :ok
    end
  end

  defp value_list?({:time_ns, [_ | _] = list}), do: Enum.all?(list, &is_integer/1)
  defp value_list?(list), do: match?([_ | _], list)

  defp count_sets(parameters),
    do: Enum.reduce(parameters, 1, fn {_, values}, n -> n * length(plain_values(values)) end)

  defp parameter_error(what) do
    Error.new(:bad_parameters, what,
      fix:
        "list the values of each parameter: [threshold: [0.4, 0.5], window: {:time_ns, [Situ.Time.ms(200)]}]"
    )
  end

  defp plain_values({:time_ns, list}), do: list
  defp plain_values(list), do: list

  defp combine([]), do: [[]]

  defp combine([first | rest]),
    do: for(value <- first, others <- combine(rest), do: [value | others])

  defp build_set(set, number) do
    %__MODULE__{
      number: number,
      values: Map.new(set, fn {name, value, _} -> {name, value} end),
      json: Map.new(set, fn {name, value, _} -> {to_string(name), json_value(value)} end),
      texts: Map.new(set, fn {name, v, kind} -> {to_string(name), format_value(v, kind)} end),
      label:
        Enum.map_join(set, " ", fn {name, value, kind} ->
          "#{name}=#{format_value(value, kind)}"
        end)
    }
  end

  defp format_value(value, {:time_ns, _}), do: Time.format_duration(value)
  defp format_value(value, _) when is_binary(value), do: value
  defp format_value(value, _), do: inspect(value, limit: 8)

  # Values that JSON lacks are written as Elixir shows them; the file of the experiment has the real ones.
  defp json_value(value) when is_number(value) or is_boolean(value) or is_nil(value), do: value

  defp json_value(value) when is_binary(value),
    do: if(String.valid?(value), do: value, else: inspect(value))

  defp json_value(list) when is_list(list), do: Enum.map(list, &json_value/1)
  defp json_value(value), do: inspect(value)
end
