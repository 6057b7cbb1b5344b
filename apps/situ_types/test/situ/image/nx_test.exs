defmodule Situ.Image.NxTest do
  # Nx cannot be a dependency. This module defines the Nx functions that are called, with the same argument order and
  # result shapes, and exists only while a test runs.
  use ExUnit.Case, async: false
  alias Situ.{AudioBuffer, AudioFormat, DepthImage, Image}

  @stand_in quote(
              do:
                defmodule Nx do
                  defstruct [:binary, :type, :shape]

                  def from_binary(binary, {_, bits} = type),
                    do: %__MODULE__{
                      binary: binary,
                      type: type,
                      shape: {div(bit_size(binary), bits)}
                    }

                  def reshape(%{shape: {n}} = t, shape),
                    do: if(Tuple.product(shape) == n, do: %{t | shape: shape})

                  def shape(t), do: t.shape
                  def type(t), do: t.type
                  def to_binary(t), do: t.binary
                end
            )

  test "returns an error without Nx" do
    assert {:error, %{code: :nx_missing}} = Image.Nx.to_nx(Image.new_filled(1, 1, :gray8))
  end

  test "converts images, depth images and audio to tensors and back" do
    Code.eval_quoted(@stand_in)

    on_exit(fn ->
      :code.purge(Nx)
      :code.delete(Nx)
    end)

    image = Image.new_filled(3, 2, :bgr24, [1, 2, 3])
    assert {:ok, %{shape: {2, 3, 3}, type: {:u, 8}} = tensor} = Image.Nx.to_nx(image)
    assert Image.Nx.to_image(tensor, :bgr24) == {:ok, image}
    assert {:error, %{code: :bad_format}} = Image.Nx.to_image(tensor, :gray8)

    depth = DepthImage.new!(width: 2, height: 1, data: <<1, 0, 2, 0>>)
    assert {:ok, %{shape: {1, 2}, type: {:u, 16}}} = Image.Nx.to_nx(depth)

    buffer = AudioBuffer.build_silence(AudioFormat.pcm(8000, 2, :f32), 5)
    assert {:ok, %{shape: {5, 2}, type: {:f, 32}} = tensor} = Image.Nx.to_nx(buffer)
    assert Image.Nx.to_audio(tensor, 8000) == {:ok, buffer}

    assert {:error, _} =
             Image.Nx.to_nx(AudioBuffer.build_silence(AudioFormat.pcm(8000, 1, :s24), 1))
  end
end
