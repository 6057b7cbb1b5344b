defmodule Situ.Build.ModuleDocs do
  @moduledoc false
  # The documentation, types, specs and struct fields of one compiled module.
  #
  # The API site and the list of public signatures are made from this, so both show the same functions.

  @enforce_keys [:name, :app, :path, :line, :text, :fields, :entries]
  defstruct [:name, :app, :path, :line, :text, :fields, :entries]

  @typedoc "`arities` are all arities that default values allow; `code` is the typespec, formatted."
  @type entry :: %{
          kind: :function | :macro | :callback | :macrocallback | :type,
          name: atom(),
          arity: arity(),
          arities: Range.t(),
          line: non_neg_integer(),
          signature: String.t(),
          text: String.t() | nil,
          since: String.t() | nil,
          deprecated: String.t() | nil,
          code: String.t()
        }
  @type t :: %__MODULE__{
          name: String.t(),
          app: String.t(),
          path: Path.t(),
          line: non_neg_integer(),
          text: String.t(),
          fields: [atom()] | nil,
          entries: [entry()]
        }

  @doc "Reads the compiled public modules `names` in the build folder `lib`, in the given order."
  @spec read_all(Path.t(), [String.t()]) :: [t()]
  def read_all(lib, names) do
    Enum.each(Path.wildcard(Path.join(lib, "*/ebin")), &Code.append_path/1)

    files =
      for path <- Path.wildcard(Path.join(lib, "*/ebin/Elixir.Situ*.beam")),
          into: %{},
          do: {path |> Path.basename(".beam") |> String.replace_prefix("Elixir.", ""), path}

    for name <- names, path = files[name], do: read_module(path)
  end

  defp read_module(beam) do
    {:docs_v1, annotation, _language, _format, %{"en" => text}, _metadata, docs} =
      Code.fetch_docs(beam)

    {:ok, {module, [compile_info: info]}} =
      :beam_lib.chunks(String.to_charlist(beam), [:compile_info])

    code = read_code(module)

    %__MODULE__{
      name: inspect(module),
      app: beam |> Path.dirname() |> Path.dirname() |> Path.basename(),
      path: relative_source(to_string(info[:source])),
      line: :erl_anno.line(annotation),
      text: text,
      fields: struct_fields(module),
      entries: for(doc <- docs, public_entry?(doc), do: build_entry(doc, code))
    }
  end

  @doc "Returns all texts of a module's documentation."
  @spec list_texts(t()) :: [String.t()]
  def list_texts(module),
    do: [module.text | for(entry <- module.entries, entry.text != nil, do: entry.text)]

  defp public_entry?({{_, :__struct__, _}, _, _, _, _}), do: false
  defp public_entry?({_, _, _, :hidden, _}), do: false
  defp public_entry?(_doc), do: true

  defp build_entry({{kind, name, arity}, annotation, signature, doc, metadata}, code) do
    %{
      kind: kind,
      name: name,
      arity: arity,
      arities: (arity - Map.get(metadata, :defaults, 0))..arity,
      line: :erl_anno.line(annotation),
      signature: format_signature(signature, name, arity),
      text: if(is_map(doc), do: doc["en"]),
      since: metadata[:since],
      deprecated: metadata[:deprecated],
      code: code |> Map.get({spec_kind(kind), name, arity}, []) |> Enum.join("\n")
    }
  end

  defp format_signature([], name, arity), do: "#{name}/#{arity}"
  defp format_signature(lines, _name, _arity), do: Enum.join(lines, " ")

  defp spec_kind(kind) when kind in [:callback, :macrocallback], do: :callback
  defp spec_kind(:type), do: :type
  defp spec_kind(_kind), do: :spec

  # Typespecs by kind, name and arity. Those of macros have another name and one more argument in the compiled module.
  defp read_code(module) do
    specs = collect_specs(:spec, "@spec ", Code.Typespec.fetch_specs(module))
    callbacks = collect_specs(:callback, "@callback ", Code.Typespec.fetch_callbacks(module))
    Map.new(specs ++ callbacks ++ collect_types(Code.Typespec.fetch_types(module)))
  end

  defp collect_specs(_kind, _prefix, :error), do: []

  defp collect_specs(kind, prefix, {:ok, specs}) do
    for {{name, arity}, clauses} <- specs do
      texts = for spec <- clauses, do: format_spec(prefix, name, spec)
      {{kind, name, arity}, texts}
    end
  end

  defp format_spec(prefix, name, spec),
    do: format_code(prefix, Code.Typespec.spec_to_quoted(name, spec))

  defp collect_types(:error), do: []

  defp collect_types({:ok, types}) do
    for {kind, {name, _, arguments} = type} <- types, kind != :typep do
      {{:type, name, length(arguments)}, [format_type(kind, Code.Typespec.type_to_quoted(type))]}
    end
  end

  # The definition of an opaque type is private.
  defp format_type(:opaque, {:"::", _, [head, _]}), do: format_code("@opaque ", head)
  defp format_type(_kind, quoted), do: format_code("@type ", quoted)

  defp format_code(prefix, quoted) do
    # Without the lines of the source, the formatter breaks only lines that are too long.
    code = quoted |> Macro.prewalk(&Macro.update_meta(&1, fn _ -> [] end)) |> Macro.to_string()

    (prefix <> code)
    |> Code.format_string!(line_length: 90)
    |> IO.iodata_to_binary()
  end

  defp struct_fields(module) do
    if Code.ensure_loaded?(module) and function_exported?(module, :__struct__, 0) do
      for %{field: field} <- module.__info__(:struct), field != :__exception__, do: field
    end
  end

  # The compiled module has the path of the machine that compiled it.
  defp relative_source(source) do
    case String.split(source, "/apps/") do
      [_, _ | _] = parts -> "apps/" <> List.last(parts)
      _ -> source
    end
  end
end
