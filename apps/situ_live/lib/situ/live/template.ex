defmodule Situ.Live.Template do
  @moduledoc false
  # Compiles `~H`, the part of Phoenix's HEEx that views need. The documentation of `Situ.Live.Component` describes
  # it.
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
