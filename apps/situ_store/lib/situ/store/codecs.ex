defmodule Situ.Store.Codecs do
  @moduledoc false
  # Finds the module of a codec by name among the modules of the applications that build on Situ.

  @key {__MODULE__, :names}

  @spec find(String.t(), String.t() | nil) :: module() | nil
  def find(name, module_name) do
    named(module_name, name) || Map.get(names(), name) || Map.get(rescan(), name)
  end

  @doc "Returns the codec module that stores data like `data`, or `nil`."
  @spec of(term()) :: module() | nil
  def of(%module{}), do: if(codec?(module), do: module)
  def of(_), do: nil

  defp codec?(module) do
    case :persistent_term.get({__MODULE__, module}, nil) do
      nil ->
        answer = Situ.Codec.implemented_by?(module)
        :persistent_term.put({__MODULE__, module}, answer)
        answer

      answer ->
        answer
    end
  end

  defp named(nil, _name), do: nil

  defp named(module_name, name) do
    with {:ok, module} <- Situ.KnownModules.fetch(module_name),
         true <- Situ.Codec.implemented_by?(module) and module.codec_name() == name do
      module
    else
      _ -> nil
    end
  end

  defp names, do: :persistent_term.get(@key, %{})

  defp rescan do
    apps =
      for {app, _, _} <- Application.loaded_applications(),
          app in [:situ, :situ_types] or :situ in (Application.spec(app, :applications) || []),
          do: app

    loaded = length(apps)

    case :persistent_term.get({__MODULE__, :scanned}, 0) do
      ^loaded ->
        names()

      _ ->
        found =
          for app <- apps,
              module <- Application.spec(app, :modules) || [],
              Situ.Codec.implemented_by?(module),
              into: %{},
              do: {module.codec_name(), module}

        :persistent_term.put(@key, found)
        :persistent_term.put({__MODULE__, :scanned}, loaded)
        found
    end
  end
end
