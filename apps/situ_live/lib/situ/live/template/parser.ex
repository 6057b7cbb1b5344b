defmodule Situ.Live.Template.Parser do
  @moduledoc false
  # Parses a template string into nodes, by recursive descent.
  #
  #   {:text, text} | {:expr, ast} | {:element, name, attributes, children | :void, position}
  #   attribute: {name, text | true | {:expr, ast}} | {:spread, ast}
  #
  # `ctx` contains the file, line, column and the indentation that the heredoc removed.

  @void_elements ~w(area base br col embed hr img input link meta param source track wbr)
  @space [?\s, ?\n, ?\t, ?\r]
  @name_end [?/, ?>, ?= | @space]

  @type position :: %{file: String.t(), line: pos_integer(), column: pos_integer()}
  @type ast_node :: tuple()

  @spec parse(String.t(), map()) :: [ast_node()]
  def parse(source, position) do
    {nodes, "", _} = parse_nodes(source, Map.put(position, :curly?, true), nil, [])
    nodes
  end

  defp parse_nodes("", ctx, nil, acc), do: {Enum.reverse(acc), "", ctx}
  defp parse_nodes("", _ctx, {tag, at}, _), do: raise_error(at, "<#{tag}> is not closed")

  defp parse_nodes("<%!--" <> rest, ctx, tag, acc) do
    {skipped, rest} = take_until(rest, "--%>", ctx, "<%!--")
    parse_nodes(rest, advance_position(ctx, "<%!--" <> skipped <> "--%>"), tag, acc)
  end

  defp parse_nodes("<%=" <> rest, ctx, tag, acc) do
    {code, rest} = take_until(rest, "%>", ctx, "<%=")
    ast = parse_code(code, advance_position(ctx, "<%="))
    parse_nodes(rest, advance_position(ctx, "<%=" <> code <> "%>"), tag, [{:expr, ast} | acc])
  end

  defp parse_nodes("<%" <> _, ctx, _, _),
    do:
      raise_error(ctx, "blocks (<% ... %>) are not supported in ~H: use :if, :for or a component")

  defp parse_nodes("<!--" <> rest, ctx, tag, acc) do
    {comment, rest} = take_until(rest, "-->", ctx, "<!--")
    text = "<!--" <> comment <> "-->"
    parse_nodes(rest, advance_position(ctx, text), tag, [{:text, text} | acc])
  end

  defp parse_nodes("<!" <> rest, ctx, tag, acc) do
    {declaration, rest} = take_until(rest, ">", ctx, "<!")
    text = "<!" <> declaration <> ">"
    parse_nodes(rest, advance_position(ctx, text), tag, [{:text, text} | acc])
  end

  defp parse_nodes("</" <> rest, ctx, open, acc) do
    {name, rest} = take_until(rest, ">", ctx, "</")

    case {String.trim(name), open} do
      {name, {name, _}} ->
        {Enum.reverse(acc), rest, advance_position(ctx, "</" <> name <> ">")}

      {name, nil} ->
        raise_error(ctx, "</#{name}> closes nothing")

      {name, {tag, at}} ->
        raise_error(ctx, "</#{name}> where <#{tag}> of line #{at.line} must be closed")
    end
  end

  defp parse_nodes(<<"<", c, _::binary>> = source, ctx, tag, acc)
       when c in ?a..?z or c in ?A..?Z or c in [?., ?:] do
    {element, rest, ctx} = parse_element(source, ctx)
    parse_nodes(rest, ctx, tag, [element | acc])
  end

  defp parse_nodes("\\{" <> rest, ctx, tag, acc),
    do: parse_nodes(rest, advance_position(ctx, "\\{"), tag, [{:text, "{"} | acc])

  defp parse_nodes("{" <> rest, %{curly?: true} = ctx, tag, acc) do
    {ast, rest, ctx} = parse_braces(rest, advance_position(ctx, "{"))
    parse_nodes(rest, ctx, tag, [{:expr, ast} | acc])
  end

  defp parse_nodes(source, ctx, tag, acc) do
    stops = if ctx.curly?, do: ["<", "{", "\\{"], else: ["<"]
    {text, rest} = take_text(source, stops)
    parse_nodes(rest, advance_position(ctx, text), tag, [{:text, text} | acc])
  end

  # Takes at least one character, so that a lone `<` is text.
  defp take_text(source, stops) do
    scope = {1, byte_size(source) - 1}

    case :binary.match(source, stops, scope: scope) do
      {at, _} -> {binary_part(source, 0, at), binary_part(source, at, byte_size(source) - at)}
      :nomatch -> {source, ""}
    end
  end

  defp parse_element("<" <> source, ctx) do
    {name, rest} = take_name(source)

    {attributes, ending, rest, inner} =
      parse_attributes(rest, advance_position(ctx, "<" <> name), ctx, [])

    {marks, attributes} =
      Enum.split_with(attributes, &match?({"phx-no-curly-interpolation", _}, &1))

    inner = if marks == [], do: inner, else: %{inner | curly?: false}
    at = Map.take(ctx, [:file, :line, :column])

    cond do
      ending == :closed or name in @void_elements ->
        {{:element, name, attributes, :void, at}, rest, %{inner | curly?: ctx.curly?}}

      name in ["script", "style"] ->
        {raw, rest} = take_until(rest, "</#{name}>", ctx, "<#{name}>")
        inner = advance_position(inner, raw <> "</#{name}>")
        {{:element, name, attributes, [{:text, raw}], at}, rest, %{inner | curly?: ctx.curly?}}

      true ->
        {children, rest, inner} = parse_nodes(rest, inner, {name, ctx}, [])
        {{:element, name, attributes, children, at}, rest, %{inner | curly?: ctx.curly?}}
    end
  end

  defp parse_attributes(source, ctx, tag_at, acc) do
    {space, source} = take_space(source)
    ctx = advance_position(ctx, space)

    case source do
      "/>" <> rest ->
        {Enum.reverse(acc), :closed, rest, advance_position(ctx, "/>")}

      ">" <> rest ->
        {Enum.reverse(acc), :open, rest, advance_position(ctx, ">")}

      "{" <> rest ->
        {ast, rest, ctx} = parse_braces(rest, advance_position(ctx, "{"))
        parse_attributes(rest, ctx, tag_at, [{:spread, ast} | acc])

      "" ->
        raise_error(tag_at, "this tag has no closing >")

      _ ->
        {attribute, rest, ctx} = parse_attribute(source, ctx)
        parse_attributes(rest, ctx, tag_at, [attribute | acc])
    end
  end

  defp parse_attribute(source, ctx) do
    {name, rest} = take_name(source)
    if name == "", do: raise_error(ctx, "expected an attribute name")
    ctx = advance_position(ctx, name)

    case rest do
      "={" <> rest ->
        {ast, rest, ctx} = parse_braces(rest, advance_position(ctx, "={"))
        {{name, {:expr, ast}}, rest, ctx}

      <<"=", quote, rest::binary>> when quote in [?", ?'] ->
        {value, rest} = take_until(rest, <<quote>>, ctx, <<quote>>)
        {{name, value}, rest, advance_position(ctx, <<"=", quote, value::binary, quote>>)}

      "=" <> _ ->
        raise_error(ctx, "the value of #{name} must be in quotes or braces")

      _ ->
        {{name, true}, rest, ctx}
    end
  end

  # The expression ends at the first `}` before which the code is valid Elixir.
  defp parse_braces(source, ctx, from \\ 0) do
    case :binary.match(source, "}", scope: {from, byte_size(source) - from}) do
      :nomatch ->
        parse_code(source |> String.split("\n") |> hd(), ctx)
        raise_error(ctx, "{ is not closed")

      {at, 1} ->
        code = binary_part(source, 0, at)

        case Code.string_to_quoted(code, code_options(ctx)) do
          {:ok, ast} ->
            rest = binary_part(source, at + 1, byte_size(source) - at - 1)
            {ast, rest, advance_position(ctx, code <> "}")}

          {:error, _} ->
            parse_braces(source, ctx, at + 1)
        end
    end
  end

  defp parse_code(code, ctx), do: Code.string_to_quoted!(code, code_options(ctx))

  defp code_options(ctx) do
    [file: ctx.file, line: ctx.line, column: ctx.column, columns: true, emit_warnings: false]
  end

  defp take_name(source), do: take_while(source, 0, &(&1 not in @name_end))
  defp take_space(source), do: take_while(source, 0, &(&1 in @space))

  defp take_while(source, n, accept?) do
    if n < byte_size(source) and accept?.(:binary.at(source, n)),
      do: take_while(source, n + 1, accept?),
      else: split_at(source, n)
  end

  defp split_at(source, n),
    do: {binary_part(source, 0, n), binary_part(source, n, byte_size(source) - n)}

  defp take_until(source, stop, ctx, start) do
    case :binary.split(source, stop) do
      [left, right] -> {left, right}
      [_] -> raise_error(ctx, "#{start} has no #{stop}")
    end
  end

  defp advance_position(ctx, text) do
    case :binary.matches(text, "\n") do
      [] ->
        %{ctx | column: ctx.column + String.length(text)}

      lines ->
        {last, 1} = List.last(lines)
        tail = binary_part(text, last + 1, byte_size(text) - last - 1)
        column = ctx.indentation + String.length(tail) + 1
        %{ctx | line: ctx.line + length(lines), column: column}
    end
  end

  @doc false
  @spec raise_error(position(), String.t()) :: no_return()
  def raise_error(at, description) do
    raise SyntaxError, file: at.file, line: at.line, column: at.column, description: description
  end

  @doc false
  def void_element?(name), do: name in @void_elements
end
