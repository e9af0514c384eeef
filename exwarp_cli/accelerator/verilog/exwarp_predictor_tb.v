// Runs the predictor on every test vector and compares outputs, decision and cycles.
//
// With +stall the port is often not ready; cycles are not compared then.

`default_nettype none
`timescale 1ns / 1ps

module exwarp_predictor_tb;
    `include "exwarp_vectors.vh"

    reg clk = 0;
    reg reset = 1;
    reg state_write = 0;
    reg signed [31:0] state_value = 0;
    reg start = 0;
    wire busy, done, choice, refill_ready;
    wire signed [31:0] warp, extrapolate;

    reg [31:0] states [0:VECTORS * INPUTS - 1];
    reg [31:0] expected [0:VECTORS * 3 - 1];
    reg [8 * PORT - 1:0] refills [0:REFILLS - 1];
    integer refill_at = 0;
    reg stalls = 0;
    reg [15:0] noise = 16'hACE1;
    wire refill_valid = !(stalls && noise[0]);

    exwarp_predictor predictor (
        .clk(clk), .reset(reset),
        .state_write(state_write), .state_value(state_value),
        .start(start), .busy(busy), .done(done), .choice(choice),
        .output_warp(warp), .output_extrapolate(extrapolate),
        .refill_valid(refill_valid), .refill_ready(refill_ready), .refill_data(refills[refill_at])
    );

    always #5 clk = !clk;

    always @(posedge clk) begin
        if (start) refill_at <= 0;
        else if (refill_ready && refill_valid && refill_at < REFILLS - 1) refill_at <= refill_at + 1;
    end

    always @(posedge clk) noise <= {noise[14:0], noise[15] ^ noise[13] ^ noise[12] ^ noise[10]};

    localparam MOST = 10 * CYCLES;  // cycles after which nothing more is expected
    integer cycles = 0;
    always @(posedge clk) if (busy) cycles <= cycles + 1;

    integer v, i, wrong = 0;
    initial begin
        $readmemh("vectors_input.hex", states);
        $readmemh("vectors_output.hex", expected);
        $readmemh("refill.hex", refills);
        if ($test$plusargs("stall")) stalls = 1;
        @(negedge clk);
        @(negedge clk) reset = 0;
        for (v = 0; v < VECTORS; v = v + 1) begin
            for (i = 0; i < INPUTS; i = i + 1) begin
                state_write = 1;
                state_value = states[v * INPUTS + i];
                @(negedge clk);
            end
            state_write = 0;
            start = 1;
            cycles = 0;
            @(negedge clk) start = 0;
            while (done !== 1'b1 && cycles < MOST) @(negedge clk);
            // By !==, as what is unknown differs, too.
            if (warp !== $signed(expected[3 * v]) || extrapolate !== $signed(expected[3 * v + 1])
                    || {31'd0, choice} !== expected[3 * v + 2]
                    || (cycles !== CYCLES && !stalls)) begin
                wrong = wrong + 1;
                if (wrong <= 10) begin
                    $display("vector %0d: %0d, %0d, %0d in %0d cycles; expected %0d, %0d, %0d in %0d",
                             v, warp, extrapolate, choice, cycles, $signed(expected[3 * v]),
                             $signed(expected[3 * v + 1]), expected[3 * v + 2], CYCLES);
                end
            end
        end
        if (wrong == 0) $display("passed: %0d vectors, %0d cycles each", VECTORS, CYCLES);
        else $display("failed: %0d of %0d vectors differ", wrong, VECTORS);
        $finish;
    end
endmodule

`default_nettype wire
