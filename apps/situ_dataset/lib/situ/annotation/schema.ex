defmodule Situ.Annotation.Schema do
  @moduledoc """
  Describes the attributes of a stream's annotations: names, kinds, allowed values, colours, and the keys that set the
  values.

      iex> {:ok, schema} = Situ.Annotation.Schema.parse(%{"name" => "Speech", "attributes" => [
      ...>   %{"name" => "Speaker", "kind" => "finite", "values" => [
      ...>     %{"value" => "P1", "fill" => "#1f77b4", "key" => "1"}, %{"value" => "P2", "key" => "2"}]},
      ...>   %{"name" => "Words", "kind" => "text"}]})
      iex> Situ.Annotation.Schema.default_values(schema)
      %{"Speaker" => "P1", "Words" => ""}
      iex> {:error, error} = Situ.Annotation.Schema.check_values(schema, %{"Speaker" => "P3"})
      iex> error.why
      "\\"P3\\" is not one of \\"P1\\", \\"P2\\""

  `priv/schema/annotation.schema.json` describes the JSON form (`parse/1`, `to_json/1`; `load/1` and `save/2` for
  files). The kinds are `:finite` (one of `values`), `:text`, `:number` and `:bool`. Colours are `#rrggbb`. A key is
  one character and is unique in the schema.

  ## Tiers

  `tiers` describes tracks that depend on each other, as in ELAN. The annotations of a tier have one attribute. If it
  has a `parent`, its `relation` is one of:

  | relation | annotations |
  |---|---|
  | `:included_in` | are inside an annotation of the parent; gaps are allowed |
  | `:time_subdivision` | divide an annotation of the parent, without gaps |
  | `:symbolic_subdivision` | divide it into equal parts; they have an order, but no separate times |
  | `:symbolic_association` | one for each annotation of the parent, with its times |

  A tier `Words` describes the track `Words`, and also a track for each person, such as `Words@Ada`, whose parent then
  is the parent's track of that person. Tracks without a tier have all attributes.

      iex> {:ok, schema} = Situ.Annotation.Schema.parse(%{"name" => "Speech",
      ...>   "attributes" => [%{"name" => "Text", "kind" => "text"}],
      ...>   "tiers" => [
      ...>     %{"name" => "Utterance", "attribute" => "Text"},
      ...>     %{"name" => "Words", "attribute" => "Text", "parent" => "Utterance", "relation" => "included_in"}]})
      iex> Situ.Annotation.Schema.find_tier(schema, "Words@Ada").parent
      "Utterance@Ada"

  `overlap` says what happens if a new annotation would overlap others of its track (`Situ.Annotation.Edit.annotate/2`):
  it is refused (`:refuse`), clipped to the free time (`:clip`), or replaces their parts (`:replace`).
  """
  alias Situ.Annotation.{Attribute, Tier}
  alias Situ.EditLog.{Document, JsonFormat}
  alias Situ.Error

  @enforce_keys [:name, :attributes]
  defstruct [:name, attributes: [], description: "", tiers: [], overlap: :refuse]

  @type value :: String.t() | number() | boolean()
  @type overlap :: :refuse | :clip | :replace
  @type t :: %__MODULE__{
          name: String.t(),
          description: String.t(),
          attributes: [Attribute.t()],
          tiers: [Tier.t()],
          overlap: overlap()
        }

  @overlaps %{nil => :refuse, "refuse" => :refuse, "clip" => :clip, "replace" => :replace}

  @doc "Builds a schema with one finite attribute `name`, such as `finite(\"Speech\", [\"speaking\", \"silent\"])`."
  @spec finite(String.t(), [String.t()]) :: t()
  def finite(name, values) do
    {:ok, schema} =
      parse(%{
        "name" => name,
        "attributes" => [
          %{"name" => name, "kind" => "finite", "values" => Enum.map(values, &%{"value" => &1})}
        ]
      })

    schema
  end

  @doc "Builds a schema with one free-text attribute."
  @spec text(String.t()) :: t()
  def text(name) do
    {:ok, schema} =
      parse(%{"name" => name, "attributes" => [%{"name" => name, "kind" => "text"}]})

    schema
  end

  @doc "Parses the JSON form. Error: `:bad_schema`, which says which part is invalid."
  @spec parse(term()) :: {:ok, t()} | {:error, Error.t()}
  def parse(%{"name" => name, "attributes" => [_ | _] = attributes} = json)
      when is_binary(name) do
    with :ok <- check_name(name),
         {:ok, attributes} <- parse_attributes(attributes, []),
         :ok <- check_distinct(Enum.map(attributes, & &1.name), "attribute"),
         :ok <- check_distinct(list_keys(attributes), "key"),
         {:ok, tiers} <- parse_tiers(json["tiers"], attributes),
         {:ok, overlap} <- parse_overlap(json["overlap"]) do
      description = if is_binary(json["description"]), do: json["description"], else: ""

      {:ok,
       %__MODULE__{
         name: name,
         attributes: attributes,
         description: description,
         tiers: tiers,
         overlap: overlap
       }}
    end
  end

  def parse(_),
    do: schema_error("a schema must have a \"name\" and at least one of \"attributes\"")

  defp check_name(name),
    do: if(String.trim(name) == "", do: schema_error("its name is empty"), else: :ok)

  defp parse_attributes([], done), do: {:ok, Enum.reverse(done)}

  defp parse_attributes([json | rest], done) do
    case Attribute.parse(json) do
      {:ok, attribute} -> parse_attributes(rest, [attribute | done])
      {:error, why} -> schema_error(why)
    end
  end

  defp parse_tiers(json, attributes) do
    with {:error, why} <- Tier.parse_all(json, Enum.map(attributes, & &1.name)),
         do: schema_error(why)
  end

  defp parse_overlap(name) when is_map_key(@overlaps, name), do: {:ok, @overlaps[name]}

  defp parse_overlap(name),
    do: schema_error("its overlap rule is #{inspect(name)}, not refuse, clip or replace")

  defp list_keys(attributes), do: for(a <- attributes, v <- a.values, v.key, do: v.key)

  defp check_distinct(names, kind) do
    case names -- Enum.uniq(names) do
      [] -> :ok
      [twice | _] -> schema_error("the #{kind} #{inspect(twice)} occurs twice")
    end
  end

  defp schema_error(why) do
    {:error,
     Error.new(:bad_schema, "invalid annotation schema",
       why: why,
       fix: "see priv/schema/annotation.schema.json"
     )}
  end

  @doc "Converts a schema to its JSON form."
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{} = schema) do
    json = %{
      "name" => schema.name,
      "attributes" => Enum.map(schema.attributes, &Attribute.to_json/1)
    }

    json =
      if schema.description == "",
        do: json,
        else: Map.put(json, "description", schema.description)

    json =
      if schema.tiers == [],
        do: json,
        else: Map.put(json, "tiers", Enum.map(schema.tiers, &Tier.to_json/1))

    if schema.overlap == :refuse,
      do: json,
      else: Map.put(json, "overlap", Atom.to_string(schema.overlap))
  end

  @doc "Reads a schema file."
  @spec load(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def load(path) do
    with {:ok, text} <- File.read(path),
         {:ok, json} <- Situ.JSON.decode(text),
         {:ok, schema} <- parse(json) do
      {:ok, schema}
    else
      {:error, %Error{} = error} ->
        {:error, %{error | what: "#{path} is not an annotation schema"}}

      {:error, :bad_json} ->
        schema_error("#{path} is not JSON")

      {:error, reason} ->
        {:error,
         Error.new(:not_found, "cannot read the annotation schema #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path"
         )}
    end
  end

  @doc "Writes a schema file."
  @spec save(t(), Path.t()) :: :ok | {:error, Error.t()}
  def save(%__MODULE__{} = schema, path) do
    with {:ok, _} <- Document.put(path, JsonFormat, to_json(schema)), do: :ok
  end

  @doc "Returns the attribute with that name, or `nil`."
  @spec find_attribute(t(), String.t()) :: Attribute.t() | nil
  def find_attribute(%__MODULE__{} = schema, name),
    do: Enum.find(schema.attributes, &(&1.name == name))

  @doc "Returns the default value of every attribute."
  @spec default_values(t()) :: %{String.t() => value()}
  def default_values(%__MODULE__{} = schema),
    do: Map.new(schema.attributes, &{&1.name, &1.default})

  @doc "Returns the default values of an annotation of a track: of the attribute of its tier, or of all attributes."
  @spec default_values(t(), String.t()) :: %{String.t() => value()}
  def default_values(%__MODULE__{} = schema, track) do
    case find_tier(schema, track) do
      nil -> default_values(schema)
      tier -> schema |> default_values() |> Map.take([tier.attribute])
    end
  end

  @doc "Returns the tier that describes a track, or `nil`."
  @spec find_tier(t(), String.t()) :: Tier.t() | nil
  def find_tier(%__MODULE__{} = schema, track), do: Tier.find_tier(schema.tiers, track)

  @doc "Returns the number of tiers above a track."
  @spec find_depth(t(), String.t()) :: non_neg_integer()
  def find_depth(%__MODULE__{} = schema, track) do
    case find_tier(schema, track) do
      %{parent: parent} when parent != nil -> 1 + find_depth(schema, parent)
      _ -> 0
    end
  end

  @doc "Returns the tiers that depend on a track."
  @spec child_tiers(t(), String.t()) :: [Tier.t()]
  def child_tiers(%__MODULE__{} = schema, track), do: Tier.child_tiers(schema.tiers, track)

  @doc "Checks that the values fit the schema. Errors: `:unknown_attribute`, `:bad_value`."
  @spec check_values(t(), map()) :: :ok | {:error, Error.t()}
  def check_values(%__MODULE__{} = schema, values) do
    Enum.find_value(values, :ok, fn {name, value} ->
      case find_attribute(schema, name) do
        nil -> {:error, unknown_attribute_error(schema, name)}
        attribute -> find_value_error(attribute, value)
      end
    end)
  end

  defp find_value_error(attribute, value) do
    case Attribute.check_value(attribute, value) do
      :ok ->
        nil

      {:error, why} ->
        {:error, Error.new(:bad_value, "invalid value of #{inspect(attribute.name)}", why: why)}
    end
  end

  defp unknown_attribute_error(schema, name) do
    known = Enum.map(schema.attributes, & &1.name)

    Error.new(
      :unknown_attribute,
      "schema #{inspect(schema.name)} has no attribute #{inspect(name)}",
      fix: "use one of #{Enum.map_join(known, ", ", &inspect/1)}"
    )
  end

  @doc "Parses the text of a value for its attribute; `\"12.5\"` becomes `12.5` for a number."
  @spec parse_value(t(), String.t(), String.t()) :: {:ok, value()} | {:error, Error.t()}
  def parse_value(%__MODULE__{} = schema, name, text) do
    case find_attribute(schema, name) do
      nil ->
        {:error, unknown_attribute_error(schema, name)}

      attribute ->
        value = Attribute.parse_value(attribute, text)
        find_value_error(attribute, value) || {:ok, value}
    end
  end

  @doc """
  Guesses a schema from values: an attribute is a number or boolean if all its values are, and text otherwise. Error:
  `:bad_schema`, for example for an attribute without a name.
  """
  @spec guess_from_values(String.t(), [map()]) :: {:ok, t()} | {:error, Error.t()}
  def guess_from_values(name, all_values) do
    attributes =
      all_values
      |> Enum.flat_map(&Map.to_list/1)
      |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
      |> Enum.map(fn {attribute, values} ->
        %{"name" => attribute, "kind" => guess_kind(values)}
      end)

    attributes =
      if attributes == [], do: [%{"name" => "Value", "kind" => "text"}], else: attributes

    parse(%{"name" => name, "attributes" => attributes})
  end

  defp guess_kind(values) do
    cond do
      Enum.all?(values, &is_boolean/1) -> "bool"
      Enum.all?(values, &is_number/1) -> "number"
      true -> "text"
    end
  end
end
