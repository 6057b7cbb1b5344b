defmodule Situ.Link.InspectTest do
  use ExUnit.Case, async: true

  test "a link shows its address, and not its token" do
    {:ok, address} = Situ.Link.Address.parse("situ://lab1:4001/hall")

    link = %Situ.Link{
      pid: self(),
      pipeline: nil,
      address: address,
      opts: [token: "a long secret"]
    }

    assert inspect(link) == ~s(#Situ.Link<"situ://lab1:4001/hall">)
  end
end
