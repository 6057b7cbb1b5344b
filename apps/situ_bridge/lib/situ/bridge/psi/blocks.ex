defmodule Situ.Bridge.Psi.Blocks do
  @moduledoc false
  # Folds over the blocks of all files (extents) of one kind, in order. A block is a length and a payload that is padded
  # to a multiple of 4 bytes. A length of 0 marks the end of the written data; a negative length names the next extent.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Psi.Files

  @window 1_048_576

  @typedoc "`{extent, position of the payload, length, first bytes of the payload}`"
  @type block :: {non_neg_integer(), non_neg_integer(), pos_integer(), binary()}

  @doc """
  Folds `fun` over the blocks. `fun` gets each block with its first `head` bytes, or fewer if the block is shorter.
  Returns the accumulator and sentences that describe the damage found in the files.
  """
  @spec reduce({Path.t(), String.t(), Files.kind()}, pos_integer(), acc, (block(), acc -> acc)) ::
          {acc, [String.t()]}
        when acc: term()
  def reduce({folder, name, kind}, head, acc, fun) do
    extents = Files.extent_sizes(folder, name, kind)
    context = %{files: {folder, name, kind}, extents: extents, head: head, fun: fun}

    case Map.keys(extents) do
      [] -> {acc, []}
      numbers -> reduce_extent(Enum.min(numbers), context, {acc, []})
    end
  end

  defp reduce_extent(number, context, {acc, damage}) do
    {folder, name, kind} = context.files
    path = Files.extent_path(folder, name, kind, number)

    case :file.open(path, [:read, :raw, :binary]) do
      {:ok, file} ->
        result = read_window(file, 0, Map.put(context, :extent, number), acc)
        :file.close(file)
        after_extent(result, path, number, context, damage)

      {:error, reason} ->
        {acc, ["#{path} cannot be read: #{:file.format_error(reason)}" | damage]}
    end
  end

  defp after_extent({:next, next, acc}, path, number, context, damage) do
    cond do
      next <= number ->
        {acc, ["#{path} links to itself or to an earlier file" | damage]}

      is_map_key(context.extents, next) ->
        reduce_extent(next, context, {acc, damage})

      true ->
        reduce_remaining(number, context, acc, ["the file after #{path} is missing" | damage])
    end
  end

  defp after_extent({:end, acc}, _path, number, context, damage),
    do: reduce_remaining(number, context, acc, damage)

  defp after_extent({:cut, at, acc}, path, number, context, damage),
    do:
      reduce_remaining(number, context, acc, [
        "#{path} is cut short in the message at byte #{at}" | damage
      ])

  # An extent without a link is normally the last one. If more extents exist, the link was lost.
  defp reduce_remaining(number, context, acc, damage) do
    case context.extents |> Map.keys() |> Enum.filter(&(&1 > number)) do
      [] -> {acc, damage}
      others -> reduce_extent(Enum.min(others), context, {acc, damage})
    end
  end

  defp read_window(file, at, context, acc) do
    case :file.pread(file, at, @window) do
      {:ok, bytes} -> fold_blocks(bytes, at, file, context, acc)
      _ -> {:end, acc}
    end
  end

  defp fold_blocks(<<0::32, _::binary>>, _at, _file, _context, acc), do: {:end, acc}

  defp fold_blocks(<<next::little-signed-32, _::binary>>, _at, _file, _context, acc)
       when next < 0,
       do: {:next, -next, acc}

  defp fold_blocks(<<n::little-signed-32, rest::binary>>, at, file, context, acc) do
    stored = n + padding_size(n)
    size = Map.fetch!(context.extents, context.extent)

    cond do
      at + 4 + n > size ->
        {:cut, at, acc}

      byte_size(rest) >= stored ->
        head = binary_part(rest, 0, min(n, context.head))
        <<_::binary-pinned_size(stored), rest::binary>> = rest
        acc = context.fun.({context.extent, at + 4, n, head}, acc)

        if rest == "",
          do: read_window(file, at + 4 + stored, context, acc),
          else: fold_blocks(rest, at + 4 + stored, file, context, acc)

      byte_size(rest) >= min(n, context.head) ->
        head = binary_part(rest, 0, min(n, context.head))
        acc = context.fun.({context.extent, at + 4, n, head}, acc)
        read_window(file, at + 4 + stored, context, acc)

      true ->
        # The head of the block reaches beyond this window, so the next window begins with the block.
        read_window(file, at, context, acc)
    end
  end

  # Fewer than 4 bytes remain, either at the end of the file or at the end of the window.
  defp fold_blocks(rest, at, file, context, acc) do
    if at + 4 <= Map.fetch!(context.extents, context.extent),
      do: read_window(file, at, context, acc),
      else: {if(rest == "", do: :end, else: :cut), at, acc} |> drop_position()
  end

  defp drop_position({:end, _at, acc}), do: {:end, acc}
  defp drop_position(result), do: result

  defp padding_size(n), do: rem(4 - rem(n, 4), 4)
end
