defmodule Situ.Store.ValueCodec do
  @moduledoc false
  # Encodes a value as one sequence of bytes for other programs: the length of a codec's name, the name, and the codec's
  # bytes (`Situ.Codec`: images, audio, point clouds ...). Without a name, the payload is an external term, which is
  # checked like the terms in files.
  alias Situ.Store.{Codecs, TermCodec}

  @doc """
  Encodes a value; large binaries are separate elements of the list. Returns `:error` if it is not plain data.

      iex> {:ok, bytes} = Situ.Store.ValueCodec.encode("hi")
      iex> bytes |> IO.iodata_to_binary() |> Situ.Store.ValueCodec.decode()
      {:ok, "hi"}
  """
  @spec encode(term()) :: {:ok, iodata()} | :error
  def encode(value) do
    case Codecs.module_for(value) do
      nil -> encode_term(value)
      codec -> {:ok, [encode_name(codec.codec_name()), codec.encode(value)]}
    end
  end

  defp encode_term(value) do
    case TermCodec.encode(value) do
      {:ok, bytes} -> {:ok, [encode_name(""), bytes]}
      {:error, _} -> :error
    end
  end

  defp encode_name(name), do: <<byte_size(name), name::binary>>

  @doc "Decodes a value; the error describes the bytes."
  @spec decode(binary()) :: {:ok, term()} | {:error, String.t()}
  def decode(<<0, term::binary>>), do: TermCodec.decode(term)

  def decode(<<n, name::binary-size(n), payload::binary>>) do
    case Codecs.find_module(name, nil) do
      nil ->
        {:error, "the codec #{inspect(name)} is unknown"}

      codec ->
        with {:error, why} <- codec.decode(payload),
             do: {:error, "it cannot be decoded as #{name}: #{inspect(why)}"}
    end
  end

  def decode(_bytes), do: {:error, "it is too short"}
end
