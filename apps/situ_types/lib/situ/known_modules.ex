defmodule Situ.KnownModules do
  @moduledoc """
  The modules that a name from outside may mean: a recording, a peer, a file.

  These are the modules that are loaded already, and those that a loaded application lists as its own. A name is never
  looked for as a file, so that nobody can have a `.beam` of their choice loaded, and never becomes an atom.

      iex> Situ.KnownModules.fetch("Elixir.Situ.Message")
      {:ok, Situ.Message}
      iex> {Situ.KnownModules.fetch("Elixir.Never.Heard.Of"), Situ.KnownModules.fetch(<<255>>)}
      {:error, :error}
  """

  @doc "Returns the module of this full name (`\"Elixir.My.Pose\"`), loaded, or `:error` if this system has none."
  @spec fetch(String.t()) :: {:ok, module()} | :error
  def fetch(name) do
    with :error <- find_module(name),
         do: if(load_own_types?(), do: find_module(name), else: :error)
  end

  defp find_module(name) do
    module = String.to_existing_atom(name)
    if load?(module), do: {:ok, module}, else: :error
  rescue
    ArgumentError -> :error
  end

  @doc "Loads a module that a loaded application lists, and says whether the module is loaded."
  @spec load?(module()) :: boolean()
  def load?(module) when is_atom(module),
    do: :erlang.module_loaded(module) or (listed?(module) and Code.ensure_loaded?(module))

  defp listed?(module) do
    Application.get_application(module) != nil or
      (load_own_types?() and Application.get_application(module) != nil)
  end

  # A script that starts no application still knows Situ's own types.
  defp load_own_types?, do: Application.load(:situ_types) == :ok
end
