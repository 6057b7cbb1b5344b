defmodule Situ.Live.Template.Compiler do
  @moduledoc false
  # Compiles nodes to Elixir code that builds a %Rendered{}. The parts of a template are collected as strings and
  # values, in order.
  #
  # At the top level each value is guarded by the assigns that it reads: if none of them changed, it is `:unchanged`.
  # Inside loops, branches and slots all values are computed, and the differ drops equal ones, so a wrong guard there
  # would only cost time.
  alias Situ.Live.{Comprehension, Html, Rendered}
  alias Situ.Live.Template.{Parser, Runtime}

  # A value that reads a variable of the surrounding function is always computed, because changes of variables are not
  # tracked.

  @spec compile([tuple()], [{atom(), atom()}]) :: Macro.t()
  def compile(nodes, variables), do: compile_nodes(nodes, {:top, variables})

  defp compile_nodes(nodes, level) do
    {static, values} = nodes |> trim_nodes() |> nodes_to_parts() |> join_parts([""], [])

    {vars, bindings} =
      values
      |> Enum.with_index()
      |> Enum.map(fn {ast, i} ->
        var = Macro.var(:"v#{i}", __MODULE__)
        {var, quote(do: unquote(var) = unquote(compile_value(ast, level)))}
      end)
      |> Enum.unzip()

    quote do
      unquote_splicing(bindings)

      %Rendered{
        static: unquote(static),
        dynamic: unquote(vars),
        fingerprint: unquote(template_fingerprint(static, values)),
        root?: unquote(single_root?(nodes))
      }
    end
  end

  defp template_fingerprint(static, values) do
    :erlang.phash2({static, Macro.to_string(values)}, 4_294_967_296)
  end

  # White space at the start and end comes from the heredoc, not from the author.
  defp trim_nodes(nodes) do
    nodes
    |> trim_first(&String.trim_leading/1)
    |> Enum.reverse()
    |> trim_first(&String.trim_trailing/1)
    |> Enum.reverse()
  end

  defp trim_first([{:text, text} | rest], trim) do
    case trim.(text) do
      "" -> trim_first(rest, trim)
      text -> [{:text, text} | rest]
    end
  end

  defp trim_first(nodes, _), do: nodes

  defp single_root?(nodes) do
    case trim_nodes(nodes) do
      [{:element, <<c, _::binary>>, attributes, _, _}] when c in ?a..?z ->
        not Enum.any?(attributes, &match?({directives, _} when directives in [":if", ":for"], &1))

      _ ->
        false
    end
  end

  # -- values

  defp compile_value(ast, level) do
    escaped = quote(do: unquote(Html).escape(unquote(expand_assigns(ast))))

    case list_read_assigns(ast, level) do
      :all ->
        escaped

      names ->
        quote do
          if unquote(Runtime).changed?(var!(assigns), unquote(names)),
            do: unquote(escaped),
            else: :unchanged
        end
    end
  end

  # Returns the names read as @name, or :all if `assigns` itself is used. Templates nested in the value are already
  # compiled, so the assigns that they read are found, too.
  defp list_read_assigns(_, :inner), do: :all

  defp list_read_assigns(ast, {:top, variables}) do
    {_, names} =
      Macro.prewalk(ast, [], fn
        {:@, _, [{name, _, context}]} = node, acc when is_atom(name) and is_atom(context) ->
          {node, add_name(name, acc)}

        {{:., _, [Runtime, :fetch!]}, _, [_assigns, name]}, acc ->
          {nil, add_name(name, acc)}

        {:sigil_H, _, _}, _ ->
          {nil, :all}

        {name, _, context} = node, acc when is_atom(name) and is_atom(context) ->
          {node, if({name, context} in variables, do: :all, else: acc)}

        node, acc ->
          {node, acc}
      end)

    if is_list(names), do: names |> Enum.uniq() |> Enum.sort(), else: :all
  end

  defp add_name(_, :all), do: :all
  defp add_name(name, names), do: [name | names]

  defp expand_assigns(ast) do
    Macro.prewalk(ast, fn
      {:@, meta, [{name, _, context}]} when is_atom(name) and is_atom(context) ->
        quote line: meta[:line] || 0 do
          unquote(Runtime).fetch!(var!(assigns), unquote(name))
        end

      node ->
        node
    end)
  end

  # -- parts: {:text, text} and {:value, ast}

  defp nodes_to_parts(nodes), do: Enum.flat_map(nodes, &node_to_parts/1)

  defp node_to_parts({:text, text}), do: [{:text, text}]
  defp node_to_parts({:expr, ast}), do: [{:value, ast}]

  defp node_to_parts({:element, name, attributes, children, at}) do
    {directives, rest} = Enum.split_with(attributes, &match?({":" <> _, _}, &1))
    directives = Map.new(directives)
    check_special(directives, name, at)

    case directives do
      %{":for" => {:expr, generator}} ->
        inner = attributes |> List.keydelete(":for", 0) |> List.keydelete(":key", 0)
        inner = List.keydelete(inner, ":if", 0)
        [{:value, compile_loop(generator, directives, {:element, name, inner, children, at}, at)}]

      %{":if" => {:expr, condition}} ->
        inner = {:element, name, List.keydelete(attributes, ":if", 0), children, at}
        body = compile_nodes([inner], :inner)
        [{:value, quote(line: at.line, do: if(unquote(condition), do: unquote(body)))}]

      _ ->
        element_to_parts(name, rest, directives, children, at)
    end
  end

  defp check_special(directives, name, at) do
    for {key, value} <- directives do
      unless key in [":if", ":for", ":key", ":let"],
        do:
          Parser.raise_error(at, "unknown #{key} on <#{name}>: expected :if, :for, :key or :let")

      unless match?({:expr, _}, value),
        do: Parser.raise_error(at, "#{key} on <#{name}> needs braces")
    end

    if directives[":key"] && !directives[":for"],
      do: Parser.raise_error(at, ":key on <#{name}> without :for")
  end

  # On a tag with `:for`, `:if` filters the entries.
  defp compile_loop(generator, directives, element, at) do
    {static, values} = [element] |> nodes_to_parts() |> join_parts([""], [])
    fingerprint = template_fingerprint(static, values)
    entry = Enum.map(values, &compile_value(&1, :inner))
    key = with {:expr, key} <- directives[":key"], do: key
    filter = with {:expr, condition} <- directives[":if"], do: condition
    {pattern, enumerable} = split_generator(generator, at)

    filters = if filter, do: [filter], else: []
    clauses = [{:<-, [line: at.line], [pattern, Macro.var(:entries, __MODULE__)]} | filters]
    entries = {:for, [line: at.line], clauses ++ [[do: {:{}, [], [key, entry]}]]}
    entries = Macro.prewalk(entries, &simplify_tuple/1)

    quote do
      unquote(Runtime).comprehension(
        unquote(enumerable),
        fn unquote(Macro.var(:entries, __MODULE__)) -> unquote(entries) end,
        %Comprehension{static: unquote(static), fingerprint: unquote(fingerprint), entries: []}
      )
    end
  end

  defp simplify_tuple({:{}, _, [a, b]}), do: {a, b}
  defp simplify_tuple(node), do: node

  defp split_generator({:<-, _, [pattern, enumerable]}, _at), do: {pattern, enumerable}

  defp split_generator(_, at),
    do: Parser.raise_error(at, ":for requires a generator: :for={x <- @xs}")

  defp join_parts([{:text, text} | rest], [last | static], values),
    do: join_parts(rest, [last <> text | static], values)

  defp join_parts([{:value, ast} | rest], static, values),
    do: join_parts(rest, ["" | static], [ast | values])

  defp join_parts([], static, values), do: {Enum.reverse(static), Enum.reverse(values)}

  # -- tags and components

  defp element_to_parts("." <> name, attributes, directives, children, at) do
    fun = {:&, [], [{:/, [], [{String.to_atom(name), [line: at.line], nil}, 1]}]}
    component_to_parts(fun, attributes, directives, children, at)
  end

  defp element_to_parts(<<c, _::binary>> = name, attributes, directives, children, at)
       when c in ?A..?Z do
    case Code.string_to_quoted(name <> "()", file: at.file, line: at.line) do
      {:ok, {{:., _, _} = dot, _, []}} ->
        fun = {:&, [], [{:/, [], [{dot, [no_parens: true, line: at.line], []}, 1]}]}
        component_to_parts(fun, attributes, directives, children, at)

      _ ->
        Parser.raise_error(at, "<#{name}> does not call a component; write <Module.function>")
    end
  end

  defp element_to_parts(":" <> name, _, _, _, at),
    do: Parser.raise_error(at, "the slot <:#{name}> must be directly inside a component")

  defp element_to_parts(name, attributes, directives, children, at) do
    if directives != %{},
      do: Parser.raise_error(at, ":let on <#{name}> works only on components and slots")

    open = [{:text, "<" <> name} | Enum.flat_map(attributes, &attribute_to_parts/1)]

    case children do
      :void when name in ["script", "style"] -> open ++ [{:text, "></#{name}>"}]
      :void -> open ++ [{:text, if(Parser.void_element?(name), do: ">", else: "></#{name}>")}]
      children -> open ++ [{:text, ">"}] ++ nodes_to_parts(children) ++ [{:text, "</#{name}>"}]
    end
  end

  defp attribute_to_parts({:spread, ast}),
    do: [{:value, quote(do: unquote(Html).attributes(unquote(ast)))}]

  defp attribute_to_parts({name, true}), do: [{:text, " " <> name}]

  defp attribute_to_parts({name, text}) when is_binary(text),
    do: [{:text, " #{name}=\"#{escape_quotes(text)}\""}]

  # Empty class and style attributes are kept: stylesheets may select them, and the diff is shorter.
  defp attribute_to_parts({name, {:expr, ast}}) when name in ["class", "style"] do
    value = quote(do: unquote(Html).attribute_value(unquote(ast)))
    [{:text, " #{name}=\""}, {:value, value}, {:text, "\""}]
  end

  defp attribute_to_parts({name, {:expr, ast}}) do
    [{:value, quote(do: unquote(Html).attribute_text(unquote(" " <> name), unquote(ast)))}]
  end

  # A value in single quotes may contain double quotes.
  defp escape_quotes(text), do: String.replace(text, "\"", "&quot;")

  defp component_to_parts(fun, attributes, directives, children, at) do
    children = if children == :void, do: [], else: children
    {slots, inner} = Enum.split_with(children, &match?({:element, ":" <> _, _, _, _}, &1))
    slot_pairs = slots |> Enum.group_by(&elem(&1, 1)) |> Enum.map(&compile_slots/1)

    inner_block =
      if blank_nodes?(inner), do: [], else: [compile_slot("inner_block", directives, [], inner)]

    pairs = [inner_block: inner_block] ++ slot_pairs ++ attribute_pairs(attributes)
    map = {:%{}, [], [{:__changed__, nil} | pairs]}

    map =
      for {:spread, ast} <- attributes, reduce: map do
        map -> quote(do: Map.merge(Map.new(unquote(ast)), unquote(map)))
      end

    [{:value, quote(line: at.line, do: unquote(fun).(unquote(map)))}]
  end

  defp blank_nodes?(nodes) do
    Enum.all?(nodes, &match?({:text, _}, &1)) and
      nodes |> Enum.map_join(&elem(&1, 1)) |> String.trim() == ""
  end

  defp compile_slots({":" <> name, elements}) do
    lists =
      for {:element, _, attributes, children, at} <- elements do
        {directives, attributes} = Enum.split_with(attributes, &match?({":" <> _, _}, &1))
        directives = Map.new(directives)
        check_special(directives, ":" <> name, at)

        slot =
          compile_slot(
            name,
            directives,
            attributes,
            if(children == :void, do: [], else: children)
          )

        repeat_slot(slot, directives, at)
      end

    {String.to_atom(name), quote(do: Enum.concat(unquote(lists)))}
  end

  defp repeat_slot(slot, %{":for" => {:expr, generator}} = directives, at) do
    {pattern, enumerable} = split_generator(generator, at)
    clauses = [{:<-, [], [pattern, enumerable]} | if_filter(directives)]
    {:for, [], clauses ++ [[do: slot]]}
  end

  defp repeat_slot(slot, %{":if" => {:expr, condition}}, _at),
    do: quote(do: if(unquote(condition), do: [unquote(slot)], else: []))

  defp repeat_slot(slot, _, _), do: [slot]

  defp if_filter(%{":if" => {:expr, condition}}), do: [condition]
  defp if_filter(_), do: []

  defp compile_slot(name, directives, attributes, children) do
    argument =
      case directives do
        %{":let" => {:expr, pattern}} -> pattern
        _ -> Macro.var(:_, nil)
      end

    body = compile_nodes(children, :inner)
    fun = {:fn, [], [{:->, [], [[argument], body]}]}
    pairs = [__slot__: String.to_atom(name), inner_block: fun] ++ attribute_pairs(attributes)
    {:%{}, [], pairs}
  end

  defp attribute_pairs(attributes) do
    for {name, value} <- attributes, is_binary(name) do
      {name |> String.replace("-", "_") |> attribute_atom(name), attribute_ast(value)}
    end
  end

  # Assigns are read as @name, so `-` becomes `_`; attributes for the tag (phx-click, data-x) keep their names.
  defp attribute_atom(underscored, name) do
    if name =~ ~r/\A(phx|data|aria)-/, do: String.to_atom(name), else: String.to_atom(underscored)
  end

  defp attribute_ast({:expr, ast}), do: ast
  defp attribute_ast(value), do: value
end
