defmodule Situ.Annotation.Attribute do
  @moduledoc false
  # Describes one attribute of a `Situ.Annotation.Schema` by its name, kind and default. A finite
  # attribute also has a list of values with colours and keys.
  #
  # `fill` and `text` are the colours of an attribute without a list of values. Pressing a value's
  # `key` on the keyboard sets that value.
  @kinds %{"finite" => :finite, "text" => :text, "number" => :number, "bool" => :bool}

  @enforce_keys [:name, :kind]
  defstruct [:name, :kind, :default, :fill, :text, description: "", values: []]

  @type choice :: %{
          required(:value) => String.t(),
          required(:fill) => String.t() | nil,
          required(:text) => String.t() | nil,
          required(:key) => String.t() | nil,
          optional(:description) => String.t()
        }
  @type t :: %__MODULE__{
          name: String.t(),
          kind: :finite | :text | :number | :bool,
          default: String.t() | number() | boolean() | nil,
          fill: String.t() | nil,
          text: String.t() | nil,
          description: String.t(),
          values: [choice()]
        }

  @doc false
  @spec parse(term()) :: {:ok, t()} | {:error, String.t()}
  def parse(%{"name" => name, "kind" => kind} = json)
      when is_binary(name) and is_map_key(@kinds, kind) do
    attribute = %__MODULE__{
      name: name,
      kind: @kinds[kind],
      description: if(is_binary(json["description"]), do: json["description"], else: "")
    }

    with :ok <-
           if(String.trim(name) == "", do: {:error, "an attribute has an empty name"}, else: :ok),
         {:ok, fill, text} <- parse_colours(json),
         {:ok, values} <- parse_values(attribute.kind, json["values"], name),
         attribute = %{attribute | fill: fill, text: text, values: values},
         {:ok, default} <- parse_default(attribute, json["default"]) do
      {:ok, %{attribute | default: default}}
    end
  end

  def parse(%{"name" => name}),
    do: {:error, "the kind of attribute #{inspect(name)} is not finite, text, number or bool"}

  def parse(_), do: {:error, "an attribute must be an object with a \"name\" and a \"kind\""}

  defp parse_values(:finite, [_ | _] = values, name) do
    values
    |> Enum.reduce_while({:ok, []}, fn json, {:ok, done} ->
      case parse_choice(json) do
        {:ok, choice} -> {:cont, {:ok, [choice | done]}}
        {:error, why} -> {:halt, {:error, why <> " (attribute #{inspect(name)})"}}
      end
    end)
    |> check_unique_values(name)
  end

  defp parse_values(:finite, _, name),
    do: {:error, "the finite attribute #{inspect(name)} has no values"}

  defp parse_values(_kind, none, _name) when none in [nil, []], do: {:ok, []}

  defp parse_values(_, _, name),
    do: {:error, "attribute #{inspect(name)} is not finite and cannot have a list of values"}

  defp check_unique_values({:ok, choices}, name) do
    choices = Enum.reverse(choices)
    values = Enum.map(choices, & &1.value)

    if Enum.uniq(values) == values,
      do: {:ok, choices},
      else: {:error, "attribute #{inspect(name)} lists a value twice"}
  end

  defp check_unique_values(error, _name), do: error

  defp parse_choice(value) when is_binary(value), do: parse_choice(%{"value" => value})

  defp parse_choice(%{"value" => value} = json) when is_binary(value) do
    with {:ok, fill, text} <- parse_colours(json), {:ok, key} <- parse_key(json["key"]) do
      choice = %{value: value, fill: fill, text: text, key: key}
      description = json["description"]

      if is_binary(description) and description != "",
        do: {:ok, Map.put(choice, :description, description)},
        else: {:ok, choice}
    end
  end

  defp parse_choice(_), do: {:error, "a value must be an object with a string \"value\""}

  defp parse_key(nil), do: {:ok, nil}

  defp parse_key(key) do
    if is_binary(key) and String.length(key) == 1 and String.printable?(key) and key != " ",
      do: {:ok, key},
      else: {:error, "a key must be one printable character, not #{inspect(key)}"}
  end

  defp parse_colours(json) do
    case Enum.find([json["fill"], json["text"]], &(&1 != nil and not hex_colour?(&1))) do
      nil -> {:ok, json["fill"], json["text"]}
      bad -> {:error, "a colour must be \#rrggbb, not #{inspect(bad)}"}
    end
  end

  defp hex_colour?(value), do: is_binary(value) and value =~ ~r/\A#[0-9a-fA-F]{6}\z/

  defp parse_default(%{kind: :finite, values: [first | _]}, nil), do: {:ok, first.value}
  defp parse_default(%{kind: :text}, nil), do: {:ok, ""}
  defp parse_default(%{kind: :number}, nil), do: {:ok, 0}
  defp parse_default(%{kind: :bool}, nil), do: {:ok, false}

  defp parse_default(attribute, value) do
    case check_value(attribute, value) do
      :ok -> {:ok, value}
      {:error, why} -> {:error, "invalid default of #{inspect(attribute.name)}: #{why}"}
    end
  end

  @doc false
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{} = attribute) do
    drop_nil_fields(%{
      "name" => attribute.name,
      "kind" => Atom.to_string(attribute.kind),
      "default" => attribute.default,
      "description" => if(attribute.description != "", do: attribute.description),
      "fill" => attribute.fill,
      "text" => attribute.text,
      "values" => if(attribute.values != [], do: Enum.map(attribute.values, &choice_json/1))
    })
  end

  defp choice_json(choice),
    do: choice |> Map.new(fn {k, v} -> {Atom.to_string(k), v} end) |> drop_nil_fields()

  defp drop_nil_fields(map),
    do: map |> Enum.reject(fn {_, value} -> value == nil end) |> Map.new()

  @doc "Returns `:ok` if the attribute allows the value, or `{:error, why}`."
  @spec check_value(t(), term()) :: :ok | {:error, String.t()}
  def check_value(%__MODULE__{kind: :finite, values: choices}, value) do
    if Enum.any?(choices, &(&1.value == value)),
      do: :ok,
      else:
        {:error,
         "#{inspect(value)} is not one of #{Enum.map_join(choices, ", ", &inspect(&1.value))}"}
  end

  def check_value(%__MODULE__{kind: :text}, value) do
    if is_binary(value) and String.valid?(value),
      do: :ok,
      else: {:error, "#{inspect(value)} is not a string"}
  end

  def check_value(%__MODULE__{kind: :number}, value),
    do: if(is_number(value), do: :ok, else: {:error, "#{inspect(value)} is not a number"})

  def check_value(%__MODULE__{kind: :bool}, value),
    do:
      if(is_boolean(value), do: :ok, else: {:error, "#{inspect(value)} is neither true nor false"})

  @doc "Parses text to a number or boolean if the attribute has that kind; returns other text unchanged."
  @spec parse_value(t(), String.t()) :: term()
  def parse_value(%__MODULE__{kind: :number}, text), do: parse_number(text)

  def parse_value(%__MODULE__{kind: :bool}, text) when text in ["true", "false"],
    do: text == "true"

  def parse_value(_attribute, text), do: text

  @doc """
  Parses text to a number; returns other text unchanged.

      iex> Enum.map(["4", "0.5", "4 px"], &Situ.Annotation.Attribute.parse_number/1)
      [4, 0.5, "4 px"]
  """
  @spec parse_number(String.t()) :: number() | String.t()
  def parse_number(text) do
    case {Integer.parse(text), Float.parse(text)} do
      {{n, ""}, _} -> n
      {_, {x, ""}} -> x
      _ -> text
    end
  end
end
