defmodule Situ.Store.TermCodec do
  @moduledoc false
  # Decodes terms from files with one checked decoder: no functions, processes, ports or references, no new atoms, and
  # bounded memory. Atoms and structs that this system does not have become strings and maps.
  # See docs/adr/0033-terms-from-files-are-checked-before-decoding.md.
  alias Situ.Store.{Native, StructLoader}

  @spec decode(binary()) :: {:ok, term()} | {:error, String.t()}
  def decode(bytes) do
    case Native.decode_term(bytes) do
      {:ok, term} -> {:ok, term}
      {:unknown, modules, term} -> {:ok, resolve_structs(modules, bytes, term)}
      {:undecodable, reason} -> {:error, reason}
    end
  end

  @doc """
  Loads the modules of structs that were not loaded, and decodes the term again. Returns the term unchanged if no
  module could be loaded.
  """
  @spec resolve_structs([String.t()], binary(), term()) :: term()
  def resolve_structs(modules, bytes, term) do
    if StructLoader.load_modules(modules), do: decode_again(bytes, term), else: term
  end

  # Values may be atoms of other modules of the same applications.
  defp decode_again(bytes, term) do
    case Native.decode_term(bytes) do
      {:ok, better} ->
        better

      {:unknown, modules, better} ->
        if StructLoader.load_applications(modules), do: decode_partly(bytes), else: better

      {:undecodable, _} ->
        term
    end
  end

  defp decode_partly(bytes) do
    case Native.decode_term(bytes) do
      {:ok, term} -> term
      {:unknown, _, term} -> term
    end
  end

  @doc "Encodes a term, or returns an error if it contains anything but plain data."
  @spec encode(term()) :: {:ok, binary()} | {:error, {:not_storable, String.t()}}
  def encode(term) do
    bytes = :erlang.term_to_binary(term)

    case Native.check_term(bytes) do
      :ok -> {:ok, bytes}
      {:error, reason} -> {:error, {:not_storable, reason}}
    end
  end
end
