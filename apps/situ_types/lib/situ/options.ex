defmodule Situ.Options do
  @moduledoc """
  Option schemas. One keyword list validates options, fills in defaults, generates documentation, and suggests the
  nearest name for a typo.

      schema = [
        rate: [type: :pos_integer, default: 16_000, doc: "Samples per second."],
        mode: [type: {:in, [:fast, :exact]}, default: :exact, doc: "How to resample."]
      ]

  Types: `:any`, `:atom`, `:boolean`, `:integer`, `:pos_integer`, `:non_neg_integer`, `:number`, `:float`, `:string`,
  `:list`, `:keyword`, `:map`, `:module`, `:pid`, `:time_ns` (an integer of nanoseconds), `{:in, values}`, `{:fun,
  arity}`, `{:list, type}`, `{:range, min, max}` (a number, both ends included), `{:integer, min, max}` (an integer,
  both ends included), `{:struct, module}`, `{:tuple, [type]}`, `{:or, [type]}` and `{:optional, type}` (the type or
  `nil`).
  """
  alias Situ.Error
  alias Situ.Options.Parsing

  @type type :: atom() | tuple()
  @type schema :: [
          {atom(), [type: type(), default: term(), required: boolean(), doc: String.t() | false]}
        ]

  @doc """
  Validates `opts` against `schema` and returns them in the schema's order, with defaults filled in.

      iex> Situ.Options.validate([], rate: [type: :pos_integer, default: 16_000, doc: "Hz."])
      {:ok, [rate: 16_000]}
      iex> {:error, error} = Situ.Options.validate([raet: 1], rate: [type: :pos_integer])
      iex> {error.code, error.fix}
      {:unknown_option, "did you mean :rate? Known options: :rate"}
      iex> {:error, error} = Situ.Options.validate([rate: 0], rate: [type: :pos_integer])
      iex> error.what
      "option :rate must be a positive integer, got: 0"
  """
  @spec validate(keyword(), schema()) :: {:ok, keyword()} | {:error, Error.t()}
  def validate(opts, schema) do
    with :ok <- check_keyword(opts),
         :ok <- check_known(opts, schema) do
      collect_values(schema, opts, [])
    end
  end

  @doc "Like `validate/2`, but returns the options or raises the `Situ.Error`."
  @spec validate!(keyword(), schema()) :: keyword()
  def validate!(opts, schema) do
    case validate(opts, schema) do
      {:ok, valid} -> valid
      {:error, error} -> raise error
    end
  end

  @doc """
  Converts options from JSON or a command line, a map with string keys, and validates them. Errors: `:unknown_option`,
  `:bad_option`, `:missing_option`.

  A string selects the atom of that name among the choices of `{:in, atoms}`. An option of type `:time_ns` also accepts
  a duration (`Situ.Time.parse_duration/1`). No atoms are created.

      iex> schema = [gap: [type: :time_ns, default: 0], mode: [type: {:in, [:fast, :exact]}]]
      iex> Situ.Options.parse(%{"mode" => "exact", "gap" => "200ms"}, schema)
      {:ok, [gap: 200_000_000, mode: :exact]}
      iex> {:error, error} = Situ.Options.parse(%{"mod" => "exact"}, schema)
      iex> {error.code, error.fix}
      {:unknown_option, "did you mean mode? Known options: gap, mode"}
  """
  @spec parse(%{String.t() => term()}, schema()) :: {:ok, keyword()} | {:error, Error.t()}
  def parse(values, schema) do
    case Parsing.parse(values, schema) do
      {:ok, opts} -> validate(opts, schema)
      {:unknown, name} -> {:error, unknown_option_error(name, schema, &to_string/1)}
    end
  end

  @doc """
  Formats `schema` as a Markdown list to interpolate into a `@moduledoc`. Options with `doc: false` are omitted.

      iex> Situ.Options.docs(rate: [type: :pos_integer, default: 16_000, doc: "Samples per second."])
      "  * `:rate` (a positive integer, default `16000`) - Samples per second."
  """
  @spec docs(schema()) :: String.t()
  def docs(schema) do
    schema
    |> Enum.reject(&hidden_option?/1)
    |> Enum.map_join("\n", fn {key, spec} ->
      "  * `#{inspect(key)}` (#{describe_type(spec[:type] || :any)}#{presence_note(spec)})#{doc_suffix(spec[:doc])}"
    end)
  end

  @doc """
  Appends the options of `schema` to the `@moduledoc` of a module that is being compiled, under `heading`. A module
  without documentation stays without.

  A module can thus begin with its purpose, although its schema is defined later:

      defmodule Greeter do
        @moduledoc "Greets people."
        @schema [name: [type: :string, doc: "The person to greet."]]
        Situ.Options.add_to_moduledoc(__MODULE__, @schema)
      end

  `use Situ.Component, options: ...` calls this function.
  """
  @spec add_to_moduledoc(module(), schema(), String.t()) :: :ok
  def add_to_moduledoc(module, schema, heading \\ "Options") do
    case {Module.get_attribute(module, :moduledoc), docs(schema)} do
      {{line, text}, list} when is_binary(text) and list != "" ->
        # Deleting first avoids the warning that the attribute is redefined.
        Module.delete_attribute(module, :moduledoc)

        Module.put_attribute(
          module,
          :moduledoc,
          {line, "#{String.trim_trailing(text)}\n\n## #{heading}\n\n#{list}\n"}
        )

        :ok

      _private_or_without_options ->
        :ok
    end
  end

  @doc """
  Returns the name in `known` that is most similar to `name`, or `nil` if none is similar.

      iex> Situ.Options.nearest_name("tresh", ["threshold", "rate"])
      "threshold"
      iex> Situ.Options.nearest_name("xyz", ["threshold"])
      nil
  """
  @spec nearest_name(atom() | String.t(), [name]) :: name | nil when name: atom() | String.t()
  def nearest_name(name, known) do
    known
    |> Enum.map(&{String.jaro_distance(to_string(&1), to_string(name)), &1})
    |> Enum.filter(fn {distance, _} -> distance > 0.6 end)
    |> Enum.max_by(&elem(&1, 0), fn -> {0.0, nil} end)
    |> elem(1)
  end

  defp presence_note(spec) do
    cond do
      spec[:required] -> ", required"
      Keyword.has_key?(spec, :default) -> ", default `#{inspect(spec[:default])}`"
      true -> ""
    end
  end

  defp doc_suffix(nil), do: ""
  defp doc_suffix(text), do: " - " <> text

  defp check_keyword(opts) do
    if Keyword.keyword?(opts),
      do: :ok,
      else:
        {:error, Error.new(:bad_options, "options must be a keyword list, got: #{inspect(opts)}")}
  end

  defp hidden_option?({_key, spec}), do: spec[:doc] == false

  defp check_known(opts, schema) do
    case Enum.find(Keyword.keys(opts), &(not Keyword.has_key?(schema, &1))) do
      nil ->
        :ok

      bad ->
        {:error, unknown_option_error(bad, schema, &inspect/1)}
    end
  end

  # `format` writes the known names as the caller writes them.
  defp unknown_option_error(bad, schema, format) do
    known = schema |> Enum.reject(&hidden_option?/1) |> Keyword.keys()

    Error.new(:unknown_option, "unknown option #{inspect(bad)}",
      fix: unknown_option_hint(bad, known, format)
    )
  end

  defp unknown_option_hint(_bad, [], _format), do: "remove it: no options are supported here"

  defp unknown_option_hint(bad, known, format) do
    list = "Known options: " <> Enum.map_join(known, ", ", format)

    case nearest_name(bad, known) do
      nil -> list
      near -> "did you mean #{format.(near)}? " <> list
    end
  end

  defp collect_values([], _opts, valid), do: {:ok, Enum.reverse(valid)}

  defp collect_values([{key, spec} | rest], opts, valid) do
    case fetch_value(opts, key, spec) do
      {:ok, value} -> collect_values(rest, opts, [{key, value} | valid])
      :absent -> collect_values(rest, opts, valid)
      {:error, _} = error -> error
    end
  end

  defp fetch_value(opts, key, spec) do
    case {Keyword.fetch(opts, key), Keyword.fetch(spec, :default)} do
      {{:ok, value}, _} -> check_type(key, value, spec[:type] || :any)
      {:error, {:ok, default}} -> {:ok, default}
      {:error, :error} -> if spec[:required], do: missing_option_error(key, spec), else: :absent
    end
  end

  defp missing_option_error(key, spec) do
    {:error, Error.new(:missing_option, "option #{inspect(key)} is required", fix: spec[:doc])}
  end

  defp check_type(key, value, type) do
    if matches_type?(type, value) do
      {:ok, value}
    else
      what =
        "option #{inspect(key)} must be #{describe_type(type)}, got: #{inspect(value, limit: 8)}"

      {:error, Error.new(:bad_option, what, fix: suggest_fix(type, value))}
    end
  end

  # The module of a struct may suggest the intended value, such as `Situ.Delivery.latest()` for `:latest`.
  defp suggest_fix({:optional, type}, value), do: suggest_fix(type, value)
  defp suggest_fix({:or, types}, value), do: Enum.find_value(types, &suggest_fix(&1, value))
  defp suggest_fix({:list, type}, [value | _]), do: suggest_fix(type, value)

  defp suggest_fix({:struct, module}, value),
    do:
      if(Code.ensure_loaded?(module) and function_exported?(module, :suggest, 1),
        do: module.suggest(value)
      )

  defp suggest_fix(_type, _value), do: nil

  @doc """
  Returns whether `value` matches the option type `type`.

      iex> Situ.Options.matches_type?({:list, :pos_integer}, [1, 2])
      true
  """
  @spec matches_type?(type(), term()) :: boolean()
  def matches_type?(:any, _), do: true
  def matches_type?(:atom, v), do: is_atom(v)
  def matches_type?(:boolean, v), do: is_boolean(v)
  def matches_type?(:integer, v), do: is_integer(v)
  def matches_type?(:time_ns, v), do: is_integer(v)
  def matches_type?(:pos_integer, v), do: is_integer(v) and v > 0
  def matches_type?(:non_neg_integer, v), do: is_integer(v) and v >= 0
  def matches_type?(:number, v), do: is_number(v)
  def matches_type?(:float, v), do: is_float(v)
  def matches_type?(:string, v), do: is_binary(v)
  def matches_type?(:list, v), do: is_list(v)
  def matches_type?(:keyword, v), do: Keyword.keyword?(v)
  def matches_type?(:map, v), do: is_map(v)
  def matches_type?(:module, v), do: is_atom(v) and not is_nil(v) and not is_boolean(v)
  def matches_type?(:pid, v), do: is_pid(v)
  def matches_type?({:in, values}, v), do: v in values
  def matches_type?({:fun, arity}, v), do: is_function(v, arity)
  def matches_type?({:list, type}, v), do: is_list(v) and Enum.all?(v, &matches_type?(type, &1))
  def matches_type?({:range, min, max}, v), do: is_number(v) and v >= min and v <= max
  def matches_type?({:integer, min, max}, v), do: is_integer(v) and v >= min and v <= max
  def matches_type?({:struct, module}, v), do: is_struct(v, module)

  def matches_type?({:tuple, types}, v) do
    is_tuple(v) and tuple_size(v) == length(types) and
      types |> Enum.zip(Tuple.to_list(v)) |> Enum.all?(fn {t, e} -> matches_type?(t, e) end)
  end

  def matches_type?({:or, types}, v), do: Enum.any?(types, &matches_type?(&1, v))
  def matches_type?({:optional, type}, v), do: is_nil(v) or matches_type?(type, v)

  defp describe_type(:any), do: "anything"
  defp describe_type(:integer), do: "an integer"
  defp describe_type(:pos_integer), do: "a positive integer"
  defp describe_type(:non_neg_integer), do: "an integer of 0 or more"
  defp describe_type(:time_ns), do: "an integer of nanoseconds"
  defp describe_type(:keyword), do: "a keyword list"
  defp describe_type({:in, values}), do: "one of " <> Enum.map_join(values, ", ", &inspect/1)
  defp describe_type({:fun, arity}), do: "a function of #{arity} arguments"
  defp describe_type({:list, type}), do: "a list, each element #{describe_type(type)}"
  defp describe_type({:range, min, max}), do: "a number from #{min} to #{max}"
  defp describe_type({:integer, min, max}), do: "an integer from #{min} to #{max}"
  defp describe_type({:struct, module}), do: "a %#{inspect(module)}{}"

  defp describe_type({:tuple, types}),
    do: "a tuple of " <> Enum.map_join(types, ", ", &describe_type/1)

  defp describe_type({:or, types}), do: Enum.map_join(types, " or ", &describe_type/1)
  defp describe_type({:optional, type}), do: describe_type(type) <> " or nil"
  defp describe_type(type) when type in [:atom], do: "an atom"
  defp describe_type(type), do: "a " <> to_string(type)
end
