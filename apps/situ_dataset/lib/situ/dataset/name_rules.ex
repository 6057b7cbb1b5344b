defmodule Situ.Dataset.NameRules do
  @moduledoc false
  # Checks the names of sessions and partitions: they are unique, and valid in a stream address "[Partition]:Stream".
  alias Situ.Error

  @longest 200

  @typep named :: %{:name => String.t(), optional(atom()) => term()}

  @spec check_valid(term(), String.t()) :: :ok | {:error, Error.t()}
  def check_valid(name, kind) do
    if is_binary(name) and String.valid?(name) and name =~ ~r/\A[^\x00-\x1f\]\[]+\z/u and
         String.length(name) <= @longest and String.trim(name) == name do
      :ok
    else
      {:error,
       Error.new(:bad_name, "invalid name for a #{kind}: #{inspect(name)}",
         fix:
           "use 1 to #{@longest} printable characters without [ and ], and without blanks at the ends"
       )}
    end
  end

  @spec check_free(String.t(), [named()], String.t()) :: :ok | {:error, Error.t()}
  def check_free(name, items, owner) do
    if Enum.any?(items, &(&1.name == name)) do
      {:error,
       Error.new(:duplicate_name, "#{owner} already has a #{inspect(name)}",
         why: "names must be unique there",
         fix: "choose another name"
       )}
    else
      :ok
    end
  end

  @spec fetch_named([named()], String.t(), atom(), String.t(), String.t()) ::
          {:ok, named()} | {:error, Error.t()}
  def fetch_named(all, name, code, kind, owner) do
    case Enum.find(all, &(&1.name == name)) do
      nil -> {:error, missing_error(name, Enum.map(all, & &1.name), code, kind, owner)}
      item -> {:ok, item}
    end
  end

  @doc "Returns the name or, if it is taken, the name with the first number that makes it unique."
  @spec make_unique(String.t(), [String.t()]) :: String.t()
  def make_unique(name, names) do
    if name in names,
      do: Enum.find_value(2..100_000, &unless("#{name} #{&1}" in names, do: "#{name} #{&1}")),
      else: name
  end

  @doc "Returns a function that matches a name to a pattern: `*` matches any text and `?` one character."
  @spec pattern_matcher(String.t()) :: (String.t() -> boolean())
  def pattern_matcher(pattern) do
    source =
      pattern
      |> String.graphemes()
      |> Enum.map_join(fn
        "*" -> ".*"
        "?" -> "."
        character -> Regex.escape(character)
      end)

    regex = Regex.compile!("\\A" <> source <> "\\z", "su")
    &(&1 =~ regex)
  end

  defp missing_error(name, known, code, kind, owner) do
    fix =
      case {Situ.Options.nearest_name(to_string(name), known), known} do
        {nil, []} -> "it does not have any"
        {nil, _} -> "use one of #{Enum.map_join(Enum.take(known, 8), ", ", &inspect/1)}"
        {near, _} -> "did you mean #{inspect(near)}?"
      end

    Error.new(code, "#{owner} has no #{kind} #{inspect(name)}", fix: fix)
  end
end
