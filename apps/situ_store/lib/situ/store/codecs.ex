defmodule Situ.Store.Codecs do
  @moduledoc false
  # Finds the module of a codec by name among the modules of the applications that build on Situ.

  alias Situ.Store.Undecoded

  @key {__MODULE__, :names}

  @spec find_module(String.t(), String.t() | nil) :: module() | nil
  def find_module(name, module_name) do
    find_named_codec(module_name, name) || Map.get(known_codecs(), name) ||
      Map.get(rescan_modules(), name)
  end

  @doc "Returns the codec module that stores data like `data`, or `nil`."
  @spec module_for(term()) :: module() | nil
  def module_for(%module{}), do: if(implements_codec?(module), do: module)
  def module_for(_), do: nil

  @doc """
  Decodes the bytes of the codec `name` with its module, `nil` if it has none. Bytes that cannot be decoded become a
  `Situ.Store.Undecoded`.
  """
  @spec decode_payload(module() | nil, String.t() | nil, binary()) :: term()
  def decode_payload(nil, name, bytes) do
    why = "no module in this system implements the codec #{inspect(name)}"
    %Undecoded{codec: name, bytes: bytes, reason: why}
  end

  def decode_payload(module, name, bytes) do
    case module.decode(bytes) do
      {:ok, data} ->
        data

      {:error, reason} ->
        %Undecoded{codec: name, bytes: bytes, reason: "#{inspect(module)}: #{inspect(reason)}"}
    end
  end

  defp implements_codec?(module) do
    case :persistent_term.get({__MODULE__, module}, nil) do
      nil ->
        answer = Situ.Codec.implemented_by?(module)
        :persistent_term.put({__MODULE__, module}, answer)
        answer

      answer ->
        answer
    end
  end

  defp find_named_codec(nil, _name), do: nil

  defp find_named_codec(module_name, name) do
    with {:ok, module} <- Situ.KnownModules.fetch_module(module_name),
         true <- Situ.Codec.implemented_by?(module) and module.codec_name() == name do
      module
    else
      _ -> nil
    end
  end

  defp known_codecs, do: :persistent_term.get(@key, %{})

  defp rescan_modules do
    apps =
      for {app, _, _} <- Application.loaded_applications(),
          app in [:situ, :situ_types] or :situ in (Application.spec(app, :applications) || []),
          do: app

    loaded = length(apps)

    case :persistent_term.get({__MODULE__, :scanned}, 0) do
      ^loaded ->
        known_codecs()

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
