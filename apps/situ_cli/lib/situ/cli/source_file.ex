defmodule Situ.CLI.SourceFile do
  @moduledoc false
  # Compiles an Elixir file that the user names on the command line, which is safe: nothing else is ever compiled.
  alias Situ.Error

  @doc "Compiles a file and returns its modules with their code. Raises an error that shows what the compiler says."
  @spec compile_file!(Path.t()) :: [{module(), binary()}]
  def compile_file!(file) do
    Code.compile_file(file)
  rescue
    error in [CompileError, SyntaxError, TokenMissingError, Code.LoadError] ->
      reraise Error.new(:not_compiled, "#{file} cannot be compiled", why: Exception.message(error)),
              __STACKTRACE__
  end
end
