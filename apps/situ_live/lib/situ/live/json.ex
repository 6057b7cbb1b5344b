defmodule Situ.Live.Json do
  @moduledoc false
  # JSON by jiffy: `nil` is null, text that is not UTF-8 is mended on the way out and refused on the way in.

  @spec encode(term()) :: binary()
  def encode(value), do: value |> :jiffy.encode([:use_nil, :force_utf8]) |> IO.iodata_to_binary()

  @spec decode(binary()) :: {:ok, term()} | {:error, :bad_json}
  def decode(text) when is_binary(text) do
    {:ok, :jiffy.decode(text, [:return_maps, :use_nil, :copy_strings])}
  rescue
    _ -> {:error, :bad_json}
  catch
    _, _ -> {:error, :bad_json}
  end

  def decode(_), do: {:error, :bad_json}
end
