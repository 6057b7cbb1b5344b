defmodule Situ.KnownModules do
  @moduledoc false
  # Finds modules by name when the name comes from a recording, a peer or a file.
  #
  # Only modules that are already loaded or that a loaded application lists can be found. The code
  # path is never searched, so an outsider cannot cause an arbitrary `.beam` file to be loaded,
  # and names never become new atoms.

  # See docs/adr/0150-names-in-files-mean-listed-modules.md.

  @doc """
  Loads and returns the module with this full name (`"Elixir.My.Pose"`); `:error` if there is
  none.

      iex> Situ.KnownModules.fetch_module("Elixir.Situ.Message")
      {:ok, Situ.Message}
      iex> {Situ.KnownModules.fetch_module("Elixir.Never.Heard.Of"), Situ.KnownModules.fetch_module(<<255>>)}
      {:error, :error}
  """
  @spec fetch_module(String.t()) :: {:ok, module()} | :error
  def fetch_module(name) do
    with :error <- find_module(name),
         do: if(load_own_types?(), do: find_module(name), else: :error)
  end

  defp find_module(name) do
    module = String.to_existing_atom(name)
    if ensure_loaded?(module), do: {:ok, module}, else: :error
  rescue
    ArgumentError -> :error
  end

  @doc "Loads a module if a loaded application lists it; returns whether the module is loaded."
  @spec ensure_loaded?(module()) :: boolean()
  def ensure_loaded?(module) when is_atom(module),
    do:
      :erlang.module_loaded(module) or
        (listed_in_application?(module) and Code.ensure_loaded?(module))

  defp listed_in_application?(module) do
    Application.get_application(module) != nil or
      (load_own_types?() and Application.get_application(module) != nil)
  end

  # A script that starts no application must still know Situ's own types.
  defp load_own_types?, do: Application.load(:situ_types) == :ok
end
