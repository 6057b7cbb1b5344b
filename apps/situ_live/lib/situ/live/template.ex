defmodule Situ.Live.Template do
  @moduledoc false
  # `~H` compiles HTML with embedded Elixir; it supports the part of Phoenix's HEEx that views
  # need.
  #
  #   * `{expression}` in text and `name={expression}` in tags are always escaped
  #   * `class={["a", @on && "b"]}`; `nil` and `false` omit an attribute, `true` writes only its name; `{map}` spreads
  #   * `:if={...}`, `:for={x <- @xs}`, `:key={x.id}` work on any tag, component or slot
  #   * `<.card title="x">`, `<Other.card>` call function components; `<:name :let={x}>` are their slots
  #   * `phx-no-curly-interpolation` on a tag makes braces inside it plain text, as they are in `<script>` and `<style>`
  #   * `<%= expression %>` equals `{expression}`; `<%!-- --%>` is omitted; blocks (`<% if ... do %>`) are rejected
  #
  # A tag that is not closed, or is closed by another name, is a compile error with file, line and
  # column. Only expressions whose assigns changed are evaluated again, so read assigns as
  # `@name`.
  # See docs/adr/0071-templates-are-compiled-here-and-diffed-by-value.md.
  alias Situ.Live.Template.{Compiler, Parser}

  @doc "Compiles a template; a variable `assigns` must be in scope."
  defmacro sigil_H({:<<>>, meta, [source]}, _modifiers) do
    unless Macro.Env.has_var?(__CALLER__, {:assigns, nil}),
      do: raise(ArgumentError, "~H requires a variable named assigns, as in def render(assigns)")

    heredoc? = meta[:indentation] != nil

    position = %{
      file: __CALLER__.file,
      line: meta[:line] + if(heredoc?, do: 1, else: 0),
      column: if(heredoc?, do: meta[:indentation] + 1, else: (meta[:column] || 1) + 3),
      indentation: meta[:indentation] || 0
    }

    rendered = source |> Parser.parse(position) |> Compiler.compile(Macro.Env.vars(__CALLER__))

    quote do
      _ = var!(assigns)
      unquote(rendered)
    end
  end
end
