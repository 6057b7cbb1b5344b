defmodule Situ.Store.Terms do
  @moduledoc false
  # Terms out of files, by one checked decoder: no functions, processes, ports or references, no new atoms, bounded
  # memory. Atoms and structs this system does not have are strings and maps.
  alias Situ.Store.{Native, Structs}

  @spec decode(binary()) :: {:ok, term()} | {:error, String.t()}
  def decode(bytes) do
    case Native.term_decode(bytes) do
      {:ok, term} -> {:ok, term}
      {:unknown, modules, term} -> {:ok, known(modules, bytes, term)}
      {:undecodable, reason} -> {:error, reason}
    end
  end

  @doc """
  A term with structs nobody here had heard of: decoded again where their modules could be loaded, else as it was.
  """
  @spec known([String.t()], binary(), term()) :: term()
  def known(modules, bytes, term) do
    if Structs.load(modules), do: once_more(bytes, term), else: term
  end

  # The values may be atoms of the other modules of the same applications.
  defp once_more(bytes, term) do
    case Native.term_decode(bytes) do
      {:ok, better} -> better
      {:unknown, modules, better} -> if Structs.load_all(modules), do: last(bytes), else: better
      {:undecodable, _} -> term
    end
  end

  defp last(bytes) do
    case Native.term_decode(bytes) do
      {:ok, term} -> term
      {:unknown, _, term} -> term
    end
  end

  @doc "Whether a term may be stored: plain data only."
  @spec encode(term()) :: {:ok, binary()} | {:error, {:not_storable, String.t()}}
  def encode(term) do
    bytes = :erlang.term_to_binary(term)

    case Native.term_check(bytes) do
      :ok -> {:ok, bytes}
      {:error, reason} -> {:error, {:not_storable, reason}}
    end
  end
end
